"""A cell that is not where it is believed to be: refused as it is, calibrated on itself, then as good as any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.calibrating.perturbed import believing, calibrated, overridden, perturbations
from tests.journeys.twin_runs import assembled, small_recipe, told, twin_cell

SEED = 5


def test_calibration_restores_docking_on_a_perturbed_twin(tmp_path: Path) -> None:
    config = overridden(twin_cell(), perturbations(np.random.default_rng(SEED)))
    before = assembled(small_recipe(), config, seed=SEED)
    assert before.verdict == "held", told(before)
    found = calibrated(config, small_recipe(), SEED)
    assert set(found.made) == {"camera", "axes", "force"}
    after = assembled(small_recipe(), believing(config, found, tmp_path), seed=SEED)
    assert after.verdict == "accepted", told(after)
    assert after.truth.good
    assert max(after.truth.peak_force_per_bolt_n) <= 10.0


def test_each_procedure_is_needed(tmp_path: Path) -> None:
    config = overridden(twin_cell(), perturbations(np.random.default_rng(SEED)))
    seen_only = calibrated(config, small_recipe(), SEED, ("camera", "axes"))
    held = assembled(small_recipe(), believing(config, seen_only, tmp_path), seed=SEED)
    assert held.verdict == "held", told(held)
    assert "force gain" in held.reasons[0]
