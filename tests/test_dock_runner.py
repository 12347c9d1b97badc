"""One dock alone: what the truth says of it, by sight and from a given pose."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from cellctl.dock_runner import DockRequest, Offset, dock_by_sight, dock_from, require_dockable
from cellctl.recipe import load_recipe
from cellctl.runner import with_twin
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError

ROOT = Path(__file__).parents[1]
RECIPE = load_recipe(ROOT / "recipes" / "lpt_shaft_36.toml")
POINTS = 150_000


def cell(**overrides: float) -> CellConfig:
    config = with_twin(load_cell(ROOT / "deploy" / "cell.fake.toml"), level="nominal", overrides=overrides)
    return config.model_copy(update={"twin": config.twin.model_copy(update={"points": POINTS})})


def request(seed: int = 1, overrides: Mapping[str, float] | None = None) -> DockRequest:
    return DockRequest(RECIPE, cell(**(overrides or {})), seed)


def test_from_the_best_pose_nothing_touches() -> None:
    outcome = dock_from(request(), Offset(0.0, 0.0, 0.0))
    assert outcome.succeeded
    assert (outcome.peak_bolt_n, outcome.reason) == (0.0, "")


def test_a_wedged_stud_is_in_but_no_success() -> None:
    outcome = dock_from(request(), Offset(0.15, 0.0, 0.0))
    assert outcome.inserted
    assert not outcome.force_ok
    assert not outcome.succeeded
    assert 10.0 < outcome.peak_bolt_n < outcome.peak_total_n
    assert "limit 10 N" in outcome.reason


def test_a_stud_on_the_flange_carries_what_the_column_yields() -> None:
    outcome = dock_from(request(), Offset(0.0, 2.0, 0.0))
    assert not outcome.inserted
    assert not outcome.force_ok
    # From the face of the flange to the spigot the jack has some 29 mm left, at 1350 N/mm.
    assert outcome.peak_total_n == pytest.approx(29.0 * 1350.0, rel=0.02)
    assert "outside its chamfer" in outcome.reason


def test_the_same_parts_stand_in_both_kinds_of_dock_and_give_the_same_truth_twice() -> None:
    first, second = (dock_from(request(7), Offset(0.08, 0.01, 0.0)) for _ in range(2))
    assert first == second
    assert first != dock_from(request(8), Offset(0.08, 0.01, 0.0))


def test_by_sight_the_studs_go_in() -> None:
    outcome = dock_by_sight(request(3))
    assert outcome.succeeded, outcome
    assert outcome.forecast is not None
    assert outcome.forecast.p_insert >= RECIPE.align.min_p_insert
    assert 0.0 < abs(outcome.offset.theta_deg) < 0.03
    assert 1 <= outcome.forecast.loops <= RECIPE.align.max_loops


def test_a_camera_that_was_moved_is_a_refusal_and_no_success() -> None:
    outcome = dock_by_sight(request(1, {"camera_rotor_shift_x_mm": 0.5}))
    assert outcome.refused == "artefact_moved"
    assert "camera or bench has moved" in outcome.reason
    assert not (outcome.succeeded or outcome.inserted or outcome.force_ok)
    assert outcome.forecast is None


def test_an_unknown_number_of_the_twin_is_refused_before_anything_runs() -> None:
    with pytest.raises(ConfigError, match="lateral_stifness"):
        require_dockable(RECIPE, cell(lateral_stifness_n_per_mm=1.0))
