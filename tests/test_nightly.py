"""The nightly campaigns: every number once, failures kept, the next night goes on where this one stopped."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

from hal.fake.levels import Imperfections, Properties, names
from tests.journeys.swarm import WRONG, random_faults, wrong_truth
from tests.nightly import Random, Result, night


def even(number: int) -> Result:
    return Result("even" if number % 2 == 0 else "odd", "is three" if number == 3 else "")


def breaks(number: int) -> Result:
    raise OSError(f"no {number}")


def test_a_night_goes_on_where_the_last_one_stopped(tmp_path: Path) -> None:
    ticks = itertools.count(0.0, 20.0)
    first = night({"even": even, "breaks": breaks}, tmp_path, 2.0, clock=lambda: next(ticks))
    assert first["even"].first == 0
    assert first["even"].next >= 3
    second = night({"even": even}, tmp_path, 2.0, clock=lambda: next(ticks))
    assert second["even"].first == first["even"].next
    entries = json.loads((tmp_path / "nightly_even.json").read_text())
    assert [entry["first"] for entry in entries] == [0, first["even"].next]
    assert sum(sum(entry["tally"].values()) for entry in entries) == second["even"].next
    assert [failure for entry in entries for failure in entry["failures"]] == [{"number": 3, "reason": "is three"}]
    assert all(entry["commit"] and entry["machine"]["cores"] for entry in entries)


def test_an_error_is_a_failure_and_not_the_end_of_the_night(tmp_path: Path) -> None:
    done = night({"breaks": breaks, "even": even}, tmp_path, 0.0)
    assert done["breaks"].failures == [{"number": 0, "reason": "OSError: no 0"}]
    assert done["even"].tally == {"even": 1}


def test_random_faults_are_repeatable_and_of_many_kinds() -> None:
    drawn = [random_faults(Random(seed), 8) for seed in range(300)]
    assert drawn == [random_faults(Random(seed), 8) for seed in range(300)]
    assert len({(fault.device, fault.kind) for faults in drawn for fault in faults}) >= 40


def test_wrong_truths_are_numbers_of_the_twin() -> None:
    assert set(WRONG) <= names(Properties) | names(Imperfections)
    drawn = [wrong_truth(Random(seed)) for seed in range(200)]
    assert {name for overrides in drawn for name in overrides} == set(WRONG)
    assert all(WRONG[name][0] <= value <= WRONG[name][1] for overrides in drawn for name, value in overrides.items())
