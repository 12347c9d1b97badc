"""What is installed: the example cell, systemd units, udev rules and the container file fit the code and each other."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cellctl.__main__ import COMMANDS
from hal.config import load_cell

UNITS = ("cellctl.service", "cellctl-guard.service")


def settings(unit: Path) -> dict[str, list[str]]:
    """Every key of a unit with its values, in order."""
    found: dict[str, list[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith(("#", "[")):
            key, _, value = line.partition("=")
            found.setdefault(key, []).append(value)
    return found


# ------------------------------------------------------------ the example cell


def test_the_example_cell_is_a_cell_of_real_devices(root: Path) -> None:
    cell = load_cell(root / "deploy/cell.example.toml")
    assert set(cell.kinds.values()) == {"canopen", "open_protocol", "kducer", "force_line", "modbus", "file_drop"}
    assert set(cell.on_fakes().kinds.values()) == {"fake"}
    framings = {entry.framing for entry in cell.entries.values() if entry.kind == "modbus"}
    assert framings == {"tcp", "rtu"}


def test_every_line_of_the_example_cell_says_what_it_is(root: Path) -> None:
    lines = (root / "deploy/cell.example.toml").read_text(encoding="utf-8").splitlines()
    bare = [line for line in lines if line and not line.startswith(("#", "[")) and not re.search(r"  # \S", line)]
    assert not bare


# ------------------------------------------------------------ units


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze on this machine")
def test_the_units_are_hardened(root: Path) -> None:
    checked = subprocess.run(["sh", root / "deploy/check-units.sh"], capture_output=True, text=True, timeout=60)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    levels = [float(found) for found in re.findall(r"service: ([\d.]+)", checked.stdout)]
    assert len(levels) == len(UNITS)
    assert max(levels) <= 1.8


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_starts_what_there_is_as_nobody_special_and_comes_back(root: Path, name: str) -> None:
    unit = settings(root / "deploy" / name)
    (command,) = unit["ExecStart"]
    words = command.split()
    if name == "cellctl.service":
        assert words[0].endswith("/cellctl")
        assert words[1] in COMMANDS
    else:
        assert words[1:3] == ["-m", "hal.guard"]
    assert "--cell" in words
    assert unit["Type"] == ["notify"], "each says by itself that it is ready"
    assert float(unit["WatchdogSec"][0]) > 0
    assert unit["User"] == ["cellctl"]
    assert unit["CapabilityBoundingSet"] == [""]
    assert unit["Restart"] == ["always"]
    assert unit["RestartPreventExitStatus"] == ["2"], "a file that is wrong is for a person"
    assert set(unit["DeviceAllow"]) == {"char-ttyUSB rw", "char-ttyACM rw"}


def test_the_guard_may_be_real_time_and_speak_can(root: Path) -> None:
    guard = settings(root / "deploy/cellctl-guard.service")
    assert guard["CPUSchedulingPolicy"] == ["fifo"]
    assert int(guard["CPUSchedulingPriority"][0]) <= int(guard["LimitRTPRIO"][0])
    assert guard["LimitMEMLOCK"] == ["infinity"]
    assert "AF_CAN" in guard["RestrictAddressFamilies"][0].split()
    assert "AF_CAN" not in settings(root / "deploy/cellctl.service")["RestrictAddressFamilies"][0].split()


# ------------------------------------------------------------ udev


def test_udev_rules_name_every_port_of_the_example_cell(root: Path) -> None:
    rules = [
        line
        for line in (root / "deploy/70-cellctl.rules").read_text(encoding="utf-8").splitlines()
        if line and not line.startswith("#")
    ]
    part = re.compile(r'(ACTION|SUBSYSTEM|DRIVER|GROUP|MODE|NAME|SYMLINK|ENV\{\w+\}|ATTRS?\{\w+\})(==|\+=|=)"[^"]+"')
    for rule in rules:
        assert all(part.fullmatch(one.strip()) for one in rule.split(",")), rule
    named = {f"/dev/{link}" for link in re.findall(r'SYMLINK\+="([^"]+)"', "\n".join(rules))}
    cell = load_cell(root / "deploy/cell.example.toml")
    ports = {getattr(entry, "path", "") or getattr(entry, "port_path", "") for entry in cell.entries.values()} - {""}
    assert ports <= named, "each has a rule"
    assert cell.can is not None
    assert f'NAME="{cell.can.channel}"' in "\n".join(rules)
    assert 'ATTR{latency_timer}="1"' in "\n".join(rules)
    network = (root / "deploy/cellctl-can.network").read_text(encoding="utf-8")
    assert f"Name={cell.can.channel}" in network
    assert f"BitRate={cell.can.bitrate // 1_000_000}M" in network


# ------------------------------------------------------------ container


def instructions(text: str) -> list[tuple[str, str]]:
    """Instructions of a container file with their arguments; a trailing backslash joins lines."""
    lines = [line for line in text.replace("\\\n", " ").splitlines() if line and not line.startswith("#")]
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in lines)]


def test_the_container_is_made_from_the_lock_and_runs_as_nobody(root: Path) -> None:
    steps = instructions((root / "deploy/Containerfile").read_text(encoding="utf-8"))
    assert steps[0][0] == "FROM"
    known = {"FROM", "ENV", "RUN", "WORKDIR", "COPY", "USER", "VOLUME", "EXPOSE", "STOPSIGNAL", "HEALTHCHECK"}
    assert {word for word, _ in steps} <= known | {"ENTRYPOINT", "CMD"}
    let_in = {
        line[1:] for line in (root / ".containerignore").read_text(encoding="utf-8").split() if line.startswith("!")
    }
    for word, rest in steps:
        if word == "COPY" and not rest.startswith("--from"):
            assert all((root / source).exists() and source in let_in for source in rest.split()[:-1]), rest
        if word == "RUN" and "uv sync" in rest:
            assert "--frozen" in rest
            assert "--no-dev" in rest
    version = re.search(r"UV_VERSION := (\S+)", (root / "Makefile").read_text(encoding="utf-8"))
    assert version is not None
    assert f"uv=={version[1]}" in dict(steps[:3])["RUN"]
    last = dict(steps)
    assert last["USER"] not in ("root", "0")
    route = re.search(r"8080(/[\w/]+)", last["HEALTHCHECK"])
    assert route is not None
    assert route[1] in json.loads((root / "deploy/openapi.json").read_text(encoding="utf-8"))["paths"]
    started = [*json.loads(last["ENTRYPOINT"]), *json.loads(last["CMD"])]
    assert started[:2] == ["cellctl", "serve"]


def test_the_guard_reaches_the_coupler_that_lets_the_guns_turn(root: Path) -> None:
    host = load_cell(root / "deploy" / "cell.example.toml").devices.tool_enable.host  # type: ignore[union-attr]
    unit = (root / "deploy" / "cellctl-guard.service").read_text(encoding="utf-8")
    assert f"IPAddressAllow={host}\n" in unit
    assert re.search(r"^RestrictAddressFamilies=.*\bAF_INET\b", unit, re.MULTILINE)
