"""Force at standstill after trips of the guard; ten thousand of them by `python -m tests.dead.force_trips`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hal.config import load_cell
from tests.dead.force_trips import CELL, LEVELS, campaign, main, tripped

SEED = 7
PROMISED_S = load_cell(CELL).guard.guard_s + load_cell(CELL).guard.bus_s
"""What the cell file allows guard and bus together."""


@pytest.mark.parametrize("level", LEVELS)
def test_as_quick_as_the_cell_file_promises_no_trip_ends_above_the_limit(level: str) -> None:
    tally = campaign(level, "promised", np.array([PROMISED_S]), trips=26, seed=SEED)  # type: ignore[arg-type]
    told = tally.told()
    assert (told["trips"], told["above"]) == (26, 0), told
    assert told["p50_n"] > tally.armed_n, "a jack that is stopped goes on for a while"


def test_a_guard_that_takes_twenty_times_as_long_is_too_late() -> None:
    told = campaign("nominal", "slow", np.array([20.0 * PROMISED_S]), trips=10, seed=SEED).told()
    assert told["above"] > 5, told


def test_a_number_alone_repeats_its_trips() -> None:
    reaction_s = np.linspace(0.0, PROMISED_S, 50)
    first, again = (tripped(3, SEED, "hostile", reaction_s) for _ in range(2))
    assert first
    assert first == again


def test_what_was_measured_is_drawn_from_and_the_table_says_how_often_the_limit_was_passed(tmp_path: Path) -> None:
    ways = {"process": {"ms": [0.2, 0.4]}, "thread": {"ms": [80.0]}, "open3d": {"ms": [200.0]}}
    (tmp_path / "reaction_delays.json").write_text(json.dumps(ways), encoding="utf-8")
    assert main(["--trips", "2", "--seed", str(SEED), "--figures", str(tmp_path)]) == 0
    rows = json.loads((tmp_path / "force_trips.json").read_text(encoding="utf-8"))["rows"]
    assert [row["above"] > 0 for row in rows] == [row["way"] != "process" for row in rows]
