"""Runs and verdicts, on the model and on traces of a real controller."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hal.fake.geometry import JointGeometry
from hal.fake.joints.curve import Condition, free_spin, loosening, tightening
from hal.fake.joints.joint import NutState, properties_of
from hal.fake.joints.tightening import GunProperties, band, drive, evaluate, first_crossing, slipping, turned
from hal.interfaces import Band, TighteningProgram, Trace
from tests.hal.fake.closed_joint import FINAL, HALF, SNUG, VERIFY

MEASURED = sorted((Path(__file__).parents[4] / "shared" / "data" / "tightening").glob("*.json"))
M8 = properties_of(JointGeometry(angles_deg=tuple(10.0 * i for i in range(36))))
GUN = GunProperties()
STARTED = NutState(present=True, climb_mm=2.0)


def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def tight(preload_n: float) -> NutState:
    return NutState(present=True, climb_mm=M8.travel_mm, preload_n=preload_n)


def test_snug_runs_down_and_stops_just_above_the_target() -> None:
    run = drive(tightening(M8, STARTED, Condition()), SNUG, GUN, rng())
    seen = evaluate(run.trace, SNUG)
    assert run.reason == "torque" and seen.ok
    assert 10.0 <= seen.torque_nm < 10.8
    assert run.duration_s == pytest.approx(14.4, abs=0.2)
    assert run.at(run.duration_s)[2] == pytest.approx(5_100.0, rel=0.1)


def test_traces_are_a_kilohertz_of_equal_lengths_from_zero() -> None:
    trace = drive(tightening(M8, STARTED, Condition()), SNUG, GUN, rng()).trace
    assert len(trace.time_s) == len(trace.angle_deg) == len(trace.torque_nm) > 1000
    assert trace.time_s[0] == 0.0 and np.allclose(np.diff(trace.time_s), 1e-3)
    assert np.allclose(np.diff(trace.angle_deg), 0.36)


def test_stages_build_up_preload_and_the_verification_turns_nothing() -> None:
    preload = 0.0
    for stage, expected in ((SNUG, 5_000), (HALF, 10_300), (FINAL, 22_300)):
        nut = tight(preload) if preload else STARTED
        run = drive(tightening(M8, nut, Condition()), stage, GUN, rng())
        preload = run.at(run.duration_s)[2]
        assert evaluate(run.trace, stage).ok and preload == pytest.approx(expected, rel=0.08)
    run = drive(tightening(M8, tight(preload), Condition()), VERIFY, GUN, rng())
    assert evaluate(run.trace, VERIFY).ok and run.at(run.duration_s)[1] == 0.0
    assert run.at(run.duration_s)[2] == preload


def test_a_rehit_shows_by_its_small_angle() -> None:
    windowed = replace(FINAL, angle_low_deg=15.0)
    seen = evaluate(drive(tightening(M8, tight(22_300.0), Condition()), windowed, GUN, rng()).trace, windowed)
    assert seen.torque_band == Band.OK and seen.angle_band == Band.LOW and not seen.ok


@pytest.mark.parametrize("unsound", [{"yield_share": 0.4}, {"stripped": True}])
def test_a_yielded_stud_and_a_stripped_thread_do_not_pass(unsound: dict[str, float]) -> None:
    nut = replace(tight(4_000.0), **unsound)
    run = drive(tightening(M8, nut, Condition()), FINAL, GUN, rng())
    assert run.reason in ("angle", "drop") and not evaluate(run.trace, FINAL).ok


def test_a_socket_that_slips_off_leaves_torque_low() -> None:
    curve = slipping(tightening(M8, tight(10_000.0), Condition()), 21.0)
    run = drive(curve, FINAL, GUN, rng())
    seen = evaluate(run.trace, FINAL)
    assert run.reason == "drop" and seen.torque_band == Band.LOW
    assert seen.torque_nm == pytest.approx(21.0, abs=0.5)
    assert 10_000.0 < run.at(run.duration_s)[2] < 14_000.0


def test_slipping_far_above_anything_changes_nothing() -> None:
    curve = free_spin(M8)
    assert slipping(curve, 21.0) is curve


def test_an_empty_socket_spins_until_the_timeout() -> None:
    run = drive(free_spin(M8), SNUG, GUN, rng())
    seen = evaluate(run.trace, SNUG)
    assert run.reason == "timeout" and run.duration_s == pytest.approx(30.0, abs=0.01)
    assert seen.torque_band == Band.LOW and seen.angle_deg == 0.0
    assert len(run.trace.time_s) < 5000


def test_loosening_frees_the_nut() -> None:
    program = replace(FINAL, direction="loosen", torque_low_nm=0.0, angle_high_deg=360.0)
    run = drive(loosening(M8, tight(20_000.0), Condition()), program, GUN, rng(), target=False)
    assert run.reason == "angle" and run.at(run.duration_s)[2] == 0.0


def test_a_run_cut_short_is_somewhere_on_its_way() -> None:
    run = drive(tightening(M8, tight(10_000.0), Condition()), FINAL, GUN, rng())
    middle, end = run.at(0.5 * run.duration_s), run.at(run.duration_s)
    assert 10_000.0 <= middle[2] < end[2] and middle[0] == pytest.approx(0.5 * end[0])
    assert run.at(-1.0)[2] == 10_000.0 and run.at(1e9) == end


def test_a_slow_turn_stops_at_its_limit() -> None:
    spindle, rotation, preload, peak = turned(tightening(M8, STARTED, Condition()), 720.0, 6.0, GUN)
    assert spindle == 720.0 and rotation == pytest.approx(720.0, abs=0.1) and preload == 0.0 and peak < 1.0
    spindle, rotation, _, peak = turned(tightening(M8, tight(10_000.0), Condition()), 20.0, 6.0, GUN)
    assert spindle == pytest.approx(1.0) and rotation == 0.0 and peak == 6.0


def test_same_generator_same_trace() -> None:
    runs = [drive(tightening(M8, STARTED, Condition()), SNUG, GUN, rng()) for _ in range(2)]
    assert np.array_equal(runs[0].trace.torque_nm, runs[1].trace.torque_nm)


def test_bands_and_crossings() -> None:
    assert [band(v, 1.0, 2.0) for v in (0.9, 1.0, 2.0, 2.1, float("nan"))] == ["low", "ok", "ok", "high", "low"]
    x, y = np.array([0.0, 10.0, 20.0]), np.array([0.0, 1.0, 3.0])
    assert first_crossing(x, y, 2.0) == 15.0 and first_crossing(x, y, -1.0) == 0.0
    assert first_crossing(x, y, 4.0) == float("inf")


# ---------------------------------------------------------------- a Bosch Rexroth CS351


def functions(step: dict[str, object]) -> dict[str, dict[str, float]]:
    return {entry["name"].replace("MFs", "MF"): entry for entry in step["tightening functions"]}  # type: ignore[index,attr-defined]


def trace_of(step: dict[str, dict[str, list[float]]]) -> Trace:
    time_s, angle_deg, torque_nm = (np.array(step["graph"][f"{name} values"]) for name in ("time", "angle", "torque"))
    return Trace(time_s, angle_deg, torque_nm)


@pytest.mark.skipif(not MEASURED, reason="measured tightenings absent: ../shared/data/tightening")
@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.stem)
def test_the_recorded_verdict_is_recomputed_from_the_windows(path: Path) -> None:
    recorded = json.loads(path.read_text())
    for step in recorded["tightening steps"]:
        bounds = functions(step)
        within = [bounds["MF TimeMax"]["act"] <= bounds["MF TimeMax"]["nom"]]
        for name in ("Torque", "Angle"):
            if f"MF {name}Max" in bounds:
                low = bounds.get(f"MF {name}Min", {"nom": -np.inf})["nom"]
                within.append(band(bounds[f"MF {name}Max"]["act"], low, bounds[f"MF {name}Max"]["nom"]) == Band.OK)
        assert step["result"] == ("OK" if all(within) else "NOK")


@pytest.mark.skipif(not MEASURED, reason="measured tightenings absent: ../shared/data/tightening")
@pytest.mark.parametrize("path", MEASURED, ids=lambda path: path.stem)
def test_torque_and_angle_of_a_real_trace_are_what_its_controller_recorded(path: Path) -> None:
    recorded = json.loads(path.read_text())
    last = recorded["tightening steps"][-1]
    bounds = functions(last)
    program = TighteningProgram(
        stage=last["name"],
        target_torque_nm=bounds["TF Torque"]["nom"],
        torque_low_nm=bounds["MF TorqueMin"]["nom"],
        torque_high_nm=bounds["MF TorqueMax"]["nom"],
        angle_low_deg=bounds["MF AngleMin"]["nom"],
        angle_high_deg=bounds["MF AngleMax"]["nom"],
        threshold_torque_nm=last["angle threshold"]["act"],
        speed_rpm=last["speed"],
        timeout_s=bounds["MF TimeMax"]["nom"],
    )
    seen = evaluate(trace_of(last), program)
    assert seen.ok and recorded["result"] == "OK"
    assert seen.torque_nm == bounds["TF Torque"]["act"]
    assert seen.angle_deg == pytest.approx(bounds["MF AngleMax"]["act"], abs=0.5)
    stricter = replace(program, torque_low_nm=seen.torque_nm + 0.1)
    assert evaluate(trace_of(last), stricter).torque_band == Band.LOW
