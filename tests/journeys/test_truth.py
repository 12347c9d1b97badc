"""Truth apart from belief: the twin differs from what the controller believes, and the run must notice or be right."""

from __future__ import annotations

from functools import cache

import pytest

from cellctl.runner import Outcome
from tests.journeys.twin_runs import assembled, small_recipe, told, twin_cell

POSES = [
    *(f"camera_{view}_shift_{axis}_mm=0.5" for view in ("rotor", "shaft") for axis in "xyz"),
    *(f"camera_{view}_rotation{about}_deg=0.1" for view in ("rotor", "shaft") for about in ("_x", "_y", "")),
]
"""Each view by 0.5 mm and by 0.1 degrees, about and along each axis."""


@cache
def perturbed(override: str) -> Outcome:
    name, _, value = override.partition("=")
    return assembled(small_recipe(), twin_cell({name: float(value)}))


def never_called_good_when_it_is_not(outcome: Outcome) -> None:
    assert outcome.verdict != "accepted" or outcome.truth.good, told(outcome)


def test_the_unperturbed_twin_is_accepted_and_good() -> None:
    outcome = assembled(small_recipe(), twin_cell())
    assert outcome.verdict == "accepted", told(outcome)
    assert outcome.truth.good


@pytest.mark.parametrize("override", POSES)
def test_a_camera_that_has_moved_is_seen_at_the_artefact(override: str) -> None:
    outcome = perturbed(override)
    never_called_good_when_it_is_not(outcome)
    assert outcome.state == "Held", told(outcome)
    assert "artefact" in outcome.reasons[0]
    assert ("rotor view" if "rotor" in override else "shaft view") in outcome.reasons[0]


@pytest.mark.parametrize("override", ["table_axis_shift_x_mm=0.2", "table_axis_shift_y_mm=-0.2"])
def test_a_wrong_table_axis_is_worked_off_by_the_loop_or_stops_the_run(override: str) -> None:
    outcome = perturbed(override)
    never_called_good_when_it_is_not(outcome)
    if outcome.verdict == "accepted":
        assert max(outcome.truth.peak_force_per_bolt_n) <= 10.0
    else:
        assert "motion" in outcome.reasons[0] or "from where it should be" in outcome.reasons[0], told(outcome)


def test_a_table_axis_far_off_is_seen_in_the_motion() -> None:
    outcome = perturbed("table_axis_shift_x_mm=2.0")
    assert outcome.state == "Held", told(outcome)
    assert "from where it should be" in outcome.reasons[0]


@pytest.mark.parametrize("gain", [0.9, 1.1])
def test_a_wrong_force_gain_is_seen_in_the_weight(gain: float) -> None:
    outcome = perturbed(f"force_gain={gain}")
    never_called_good_when_it_is_not(outcome)
    assert outcome.state == "Held", told(outcome)
    assert "force gain" in outcome.reasons[0]


@pytest.mark.parametrize("override", ["camera_shaft_shift_x_mm=0.08", "camera_rotor_rotation_deg=0.025"])
def test_an_error_below_the_artefact_gate_never_becomes_a_good_verdict_on_a_bad_joint(override: str) -> None:
    never_called_good_when_it_is_not(perturbed(override))


def test_studs_that_touch_only_while_hot_are_felt_before_the_seating_force_hides_them() -> None:
    bent = twin_cell({"hole_diameter_mm": 8.15, "jack_line_tilt_y_deg": 0.01})
    outcome = assembled(small_recipe(), bent, seed=3)
    never_called_good_when_it_is_not(outcome)
    assert outcome.state == "Held", told(outcome)
    assert "before the spigot" in outcome.reasons[0]
    assert max(outcome.truth.peak_force_per_bolt_n) > 10.0
