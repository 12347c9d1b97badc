"""The motion rules, one by one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import pytest

from hal.interfaces import AxisState, ChuckState, ParkState, SafetyState
from hal.permits import NEEDED, AxisName, PermitLimits, Readings, Target, camera_refusal, motion_refusal

LIMITS = PermitLimits(view_safe_mm=20.0, free_mm=360.0, guns_back_mm=1.0, pressure_low_bar=4.0)
STANDS = AxisState(0.0, 0.0, True, True, True, False, 0.0)
SAFETY = SafetyState(True, True, True, True, False, 0.0)
READY = Readings(
    axis=STANDS,
    safety=SAFETY,
    chuck=ChuckState(True, True, 6.0, 0.0),
    camera=ParkState("parked", 0.0),
    jack=STANDS,
    gun_feed=STANDS,
    gun_table=STANDS,
    guarded=True,
)
AXES: tuple[AxisName, ...] = get_args(AxisName)


def at(position: float, **flags: Any) -> AxisState:
    return replace(STANDS, position=position, **flags)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("target", [10.0, "home"])
def test_everything_ready_lets_every_axis_move(axis: AxisName, target: Target) -> None:
    assert motion_refusal(axis, target, READY, LIMITS) is None


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("name", ["estop_released", "guards_closed", "sto_released", "bench_locked", "bench_moved"])
@pytest.mark.parametrize("unknown", [True, False])
def test_open_or_unknown_safety_inputs_refuse_every_motion(axis: AxisName, name: str, unknown: bool) -> None:
    wrong = replace(SAFETY, **{name: None if unknown else name == "bench_moved"})
    for target in (10.0, -10.0, "home"):
        refusal = motion_refusal(axis, target, replace(READY, safety=wrong), LIMITS)  # type: ignore[arg-type]
        assert refusal is not None
        assert ("unknown" in refusal) == unknown


@pytest.mark.parametrize("axis", AXES)
def test_no_answer_from_the_safety_inputs_counts_as_tripped(axis: AxisName) -> None:
    assert "counts as tripped" in str(motion_refusal(axis, 1.0, replace(READY, safety=None), LIMITS))


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_must_be_homed_and_answer(axis: AxisName) -> None:
    lost = replace(READY, axis=at(0.0, homed=False))
    assert motion_refusal(axis, 1.0, lost, LIMITS) == f"{axis} is not homed"
    assert motion_refusal(axis, "home", lost, LIMITS) is None
    assert "does not say" in str(motion_refusal(axis, "home", replace(READY, axis=None), LIMITS))


REFUSED: list[tuple[AxisName, Target, dict[str, Any], str]] = [
    ("jack", 10.0, {"chuck": ChuckState(True, False, 6.0, 0.0)}, "chuck"),
    ("jack", 10.0, {"chuck": ChuckState(True, True, 3.9, 0.0)}, "pressure"),
    ("jack", 10.0, {"chuck": ChuckState(True, True, float("nan"), 0.0)}, "pressure"),
    ("jack", 10.0, {"chuck": None}, "chuck"),
    ("jack", 21.0, {"camera": ParkState("rotor", 0.0)}, "camera"),
    ("jack", 21.0, {"camera": ParkState(None, 0.0)}, "camera"),
    ("jack", 21.0, {"camera": None}, "camera"),
    ("jack", 361.0, {"guarded": False}, "guard is not armed"),
    ("jack", -5.0, {"gun_feed": at(1.1)}, "guns"),
    ("jack", "home", {"gun_feed": None}, "guns"),
    ("stage_x", 1.0, {"jack": at(360.1)}, "studs"),
    ("stage_y", 1.0, {"jack": at(0.0, homed=False)}, "studs"),
    ("shaft_table", "home", {"jack": None}, "studs"),
    ("shaft_table", 1.0, {"jack": at(float("nan"))}, "studs"),
    ("shaft_table", 1.0, {"camera": ParkState(None, 0.0)}, "camera"),
    ("stage_x", 1.0, {"chuck": ChuckState(False, True, 6.0, 0.0)}, "chuck"),
    ("stage_x", 1.0, {"gun_feed": at(50.0)}, "guns"),
    ("gun_table", 90.0, {"gun_feed": at(1.1)}, "guns"),
    ("gun_table", "home", {"gun_feed": at(0.0, homed=False)}, "guns"),
    ("gun_feed", 50.0, {"gun_table": at(90.0, moving=True)}, "gun table"),
    ("gun_feed", 50.0, {"gun_table": at(90.0, homed=False)}, "gun table"),
    ("gun_feed", 50.0, {"jack": at(100.0, moving=True)}, "jack"),
    ("gun_feed", 50.0, {"jack": None}, "jack"),
    ("jack", float("nan"), {"chuck": None}, "chuck"),
]


@pytest.mark.parametrize(("axis", "target", "wrong", "reason"), REFUSED)
def test_refused(axis: AxisName, target: Target, wrong: dict[str, Any], reason: str) -> None:
    assert reason in str(motion_refusal(axis, target, replace(READY, **wrong), LIMITS))


LET: list[tuple[AxisName, Target, dict[str, Any]]] = [
    ("jack", -5.0, {"chuck": None, "camera": None, "guarded": False}),
    ("jack", 15.0, {"camera": ParkState("shaft", 0.0), "guarded": False}),
    ("jack", 359.0, {"guarded": False}),
    ("jack", "home", {"chuck": None, "camera": None}),
    ("shaft_table", 5.0, {"camera": ParkState("shaft", 0.0)}),
    ("stage_x", "home", {"chuck": None}),
    ("gun_feed", -1.0, {"gun_table": None, "jack": None}),
    ("gun_feed", "home", {"gun_table": at(3.0, homed=False), "jack": None}),
    ("gun_table", 90.0, {"chuck": None, "jack": None, "camera": None}),
]


@pytest.mark.parametrize(("axis", "target", "wrong"), LET)
def test_motion_away_from_trouble_needs_least(axis: AxisName, target: Target, wrong: dict[str, Any]) -> None:
    assert motion_refusal(axis, target, replace(READY, **wrong), LIMITS) is None


def test_the_camera_swings_only_over_a_low_standing_jack() -> None:
    def refusal(target: str, jack: AxisState | None) -> str | None:
        return camera_refusal(target, replace(READY, jack=jack), LIMITS)

    assert refusal("rotor", at(20.0)) is None
    assert "in the camera's way" in str(refusal("rotor", at(20.1)))
    assert "not homed" in str(refusal("shaft", at(0.0, homed=False)))
    assert "moves" in str(refusal("parked", at(0.0, moving=True)))
    assert "does not say" in str(refusal("shaft", None))
    assert refusal("parked", at(300.0)) is None
    assert "unknown" in str(
        camera_refusal("parked", replace(READY, safety=replace(SAFETY, estop_released=None)), LIMITS)
    )


def test_each_axis_is_judged_by_devices_that_are_asked_first() -> None:
    assert set(NEEDED) == {*AXES, "camera_park"}
    assert all("safety" in needed for needed in NEEDED.values())
