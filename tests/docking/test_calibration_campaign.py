"""The campaign of stated uncertainties in small: drawn measurements, few seeds, rows that are kept, a table."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from cellctl.docking import align, align_spec
from cellctl.vision.part import Refused
from tests.docking import calibration_campaign as campaign
from tests.docking.drawn_measurement import drawn_measurement
from tests.docking.twin_cases import calibration_of, case, default_recipe, random_recipe
from tests.docking.twin_docks import HOME, docked

SEEDS = range(1, 25)


@pytest.fixture(scope="module")
def args() -> argparse.Namespace:
    return campaign._parser().parse_args(["odds", "--points", "0", "--moves", "1"])


def test_stated_covariances_are_those_of_the_errors(args: argparse.Namespace) -> None:
    """A coarse look: the figures in docs/figures come from hundreds of seeds."""
    rows = campaign.rows_of(SEEDS, lambda seed: campaign.pose_row(seed, args), None)
    summary = campaign.pose_summary(rows)
    assert 0.6 < summary["best"]["nees"] < 1.5
    assert summary["mean"]["nees"] < 1.3
    assert summary["sigma_b"][0] > 0.015 > summary["sigma_a"][0]


def test_predicted_odds_are_those_of_the_twin(args: argparse.Namespace) -> None:
    rows = campaign.rows_of(SEEDS[:12], lambda seed: campaign.odds_row(seed, args), None)
    for predicted, happened in (("p_insert", "free"), ("p_force_ok", "force_ok")):
        p = np.array([row[predicted] for row in rows])
        seen = np.array([row[happened] for row in rows])
        assert abs(seen.mean() - p.mean()) < 3.0 * np.sqrt(np.sum(p * (1.0 - p))) / len(p)
        assert p[seen].mean() > p[~seen].mean() + 0.2


def test_without_systematic_errors_nothing_of_type_b_is_stated() -> None:
    one = case(1, default_recipe(), systematic=0.0)
    done = docked(one, samples=64)
    assert np.abs(done.alignment.covariance_b).max() < 1e-18
    assert np.hypot(*done.best_error[:2]) < 0.04


def test_every_uncertainty_of_the_calibration_is_scaled() -> None:
    once, twice = calibration_of(1.0).model_dump(), calibration_of(2.0).model_dump()

    def sigmas(tree: object, path: str = "") -> dict[str, float]:
        if not isinstance(tree, dict):
            return {path: tree} if "sigma" in path and isinstance(tree, float) else {}
        found: dict[str, float] = {}
        for key, value in tree.items():
            found |= sigmas(value, f"{path}.{key}")
        return found

    assert len(sigmas(once)) >= 14
    for name, value in sigmas(once).items():
        assert sigmas(twice)[name] == (value if "jack_force" in name else pytest.approx(2.0 * value))


@pytest.mark.parametrize("seed", range(6))
def test_random_joints_can_be_docked(seed: int) -> None:
    one = case(seed, random_recipe(seed))
    plant, draw = one.plant(), np.random.default_rng(seed)
    rotor, shaft = (drawn_measurement(plant, one, view, draw) for view in ("rotor", "shaft"))
    spec = align_spec(one.recipe)
    assert align(rotor, shaft, one.calibration, HOME, spec).clearance_mm.min() > 0.05


def test_rows_are_kept_and_a_refusal_is_one(tmp_path: Path) -> None:
    path, made = tmp_path / "rows.jsonl", []

    def make(seed: int) -> dict[str, object]:
        made.append(seed)
        if seed == 2:
            raise Refused("too_noisy", "as planned")
        return {"value": seed}

    campaign.rows_of(range(1, 4), make, path)
    rows = campaign.rows_of(range(1, 6), make, path)
    assert made == [1, 2, 3, 4, 5]
    assert [row.get("value") for row in rows] == [1, None, 3, 4, 5]
    assert "too_noisy" in rows[1]["refused"]


def test_a_figure_replaces_the_one_of_the_same_command(tmp_path: Path, args: argparse.Namespace) -> None:
    rows = [
        {"best": [0.01, 0.0, 0.001], "mean": [0.0, 0.01, 0.0], "a": np.eye(3) * 1e-5, "b": np.eye(3) * 1e-4}
        for _ in range(20)
    ]
    entry = {"command": "x pose", "commit": "abc", "study": "pose", "docks": 20} | campaign.pose_summary(rows)
    campaign.add_figure(tmp_path, entry)
    campaign.add_figure(tmp_path, entry | {"docks": 21})
    entries = json.loads((tmp_path / "uncertainty.json").read_text())
    assert [one["docks"] for one in entries] == [21]
    assert "| `x pose` | 21 |" in (tmp_path / "uncertainty.md").read_text()


def test_where_rows_are_kept_is_not_part_of_the_command() -> None:
    assert campaign._lasting(["pose", "--rows", "a", "--seeds", "4", "--figures", "b"]) == ["pose", "--seeds", "4"]
