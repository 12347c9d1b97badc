"""Planted faults through whole assemblies: each file under recipes/faults/ ends as it says.

The files speak of the 36-joint recipe. A selection that meets every device runs on fewer joints with every test run;
all of them run on the whole joint in the nightly campaign.
"""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from cellctl.recipe import Recipe, load_recipe
from hal.fake.fault_file import FaultFile, load_faults
from hal.fake.fault_kinds import DEVICE_KINDS
from tests.journeys.swarm import broken
from tests.journeys.twin_runs import FAULTS, RECIPE, RememberedJobs, assembled, small_recipe, told, twin_cell

FILES = sorted(path.stem for path in FAULTS.glob("*.toml"))
WHOLE = 36
QUICK = (
    "camera_park_stuck", "chuck_opening", "gap_probe_2_drift", "gun_a_cross_thread", "gun_a_gripped_nothing",
    "gun_a_missing_washer", "gun_a_result_repeated", "gun_b_result_lost", "gun_b_slip_off", "gun_b_yielded_stud",
    "gun_feed_home_lost", "gun_force_b_out_of_range", "gun_table_stale_target", "heater_loop_break", "heater_stuck_on",
    "jack_force_nan", "jack_force_stuck", "jack_hung", "nut_feeder_missing_nut", "part_station_wrong_serial",
    "pyrometer_wrong_emissivity", "safety_bench_moved", "safety_estop", "scanner_half_frame", "scanner_old_frame",
    "scanner_wrong_unit", "shaft_table_home_lost", "spigot_tc_2_open", "stage_y_gone",
    "tool_enable_dropped",
)  # fmt: skip


@pytest.fixture(scope="module")
def jobs() -> RememberedJobs:
    return RememberedJobs()


def scaled(file: FaultFile, count: int) -> FaultFile:
    """The same faults at the joints of the same gun in a pattern of `count` joints."""

    def place(joint: float) -> int:
        return int(joint) * count // WHOLE

    assert file.expect is not None
    reason = re.sub(r"joint (\d+)", lambda found: f"joint {place(int(found[1]))}", file.expect.reason)
    faults = tuple(
        replace(fault, value=float(place(fault.number)))
        if DEVICE_KINDS[fault.device][fault.kind].unit == "joint" and fault.value is not None
        else fault
        for fault in file.faults
    )
    return FaultFile(faults, replace(file.expect, reason=reason))


def ends_as_expected(recipe: Recipe, file: FaultFile, jobs: RememberedJobs) -> None:
    expect = file.expect
    assert expect is not None
    outcome = assembled(recipe, twin_cell(), faults=file.faults, jobs=jobs)
    assert (outcome.state, outcome.verdict) == (expect.state, expect.verdict), told(outcome)
    assert expect.reason in "; ".join(outcome.reasons), told(outcome)
    assert not broken(outcome)


def test_every_device_and_at_least_forty_faults_are_in_the_files() -> None:
    planted = {(fault.device, fault.kind) for name in FILES for fault in load_faults(FAULTS / f"{name}.toml").faults}
    assert {device for device, _ in planted} == set(DEVICE_KINDS)
    assert len(planted) >= 40
    assert len({kind for _, kind in planted}) >= 30
    assert set(QUICK) < set(FILES)


@pytest.mark.parametrize("name", QUICK)
def test_it_ends_as_its_file_says(name: str, jobs: RememberedJobs) -> None:
    ends_as_expected(small_recipe(), scaled(load_faults(FAULTS / f"{name}.toml"), 8), jobs)


@pytest.mark.nightly
@pytest.mark.parametrize("name", FILES)
def test_on_the_whole_joint_it_ends_as_its_file_says(name: str, jobs: RememberedJobs) -> None:
    ends_as_expected(load_recipe(RECIPE), load_faults(FAULTS / f"{name}.toml"), jobs)
