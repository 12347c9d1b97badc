"""The contract on devices that are really there, as the environment names them: here simulators in another process."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.hardware import CELL, DEVICES
from tests.dead.processes import ROOT, cell_in
from tests.journeys.two_processes import simulated

NAMED = ("spigot_tc_1", "chuck", "tool_enable", "gap_probe_1", "safety")
FILES = ("thermometer", "chuck", "tool_enable", "gap_probe", "safety", "device")


@pytest.mark.nightly  # real time: 60 s
def test_the_contract_runs_on_devices_that_are_there(tmp_path: Path) -> None:
    config = cell_in(tmp_path)
    environment = os.environ | {CELL: str(config.path), DEVICES: ",".join(NAMED)}
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-p", "no:xdist", "-k", "hardware and not test_hardware"]
    files = [
        f"tests/contract/test_{name}.py"
        for name in ("thermometer", "chuck", "tool_enable", "gap_probe", "safety", "device")
    ]
    with simulated(config.path, "lpt_shaft_36", 1, tmp_path / "truth"):
        done = subprocess.run(
            [*command, *files], cwd=ROOT, env=environment, capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None, done.stdout
    assert int(passed[1]) >= 3 * len(NAMED), done.stdout
    reasons = set(re.findall(r"SKIPPED .*?: (.+)", done.stdout))
    assert all(re.match(r"no fault|only a twin|\w+ is not in", reason) for reason in reasons), reasons
