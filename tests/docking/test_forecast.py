"""The forecast against worlds that are wrong by what the calibration says: predicted and observed odds agree."""

from dataclasses import replace

import numpy as np

from cellctl.calibration import Calibration
from cellctl.docking import Alignment, AlignSpec, align, align_spec
from cellctl.kinematics import AxesPosition, rotation_about, shaft_at

from .parts import HEIGHT, calibration, measurement, pose, recipe

RECIPE = recipe()
ANGLES, MIRRORED = RECIPE.pattern.angles(), RECIPE.part("rotor").angles_deg
NOISE_MM, PLACE_MM = 0.012, 0.010


def _wrong_view(cal: Calibration, view: str, generator: np.random.Generator) -> np.ndarray:
    """(4, 4) that carries the true cell to the believed one, for one view."""
    belief = cal.views["rotor" if view == "rotor" else "shaft"]
    turn = generator.normal(0, np.radians(belief.sigma_rotation_deg), 3)
    size = float(np.linalg.norm(turn))
    error = np.eye(4)
    if size > 0:
        error[:3, :3] = rotation_about(turn / size, size)
    scanner = belief.matrix[:3, 3]
    error[:3, 3] = scanner - error[:3, :3] @ scanner + generator.normal(0, belief.sigma_translation_mm, 3)
    return error


def _true_axes(cal: Calibration, generator: np.random.Generator) -> Calibration:
    lines = {}
    for name in ("table_axis", "jack_line"):
        line = getattr(cal, name)
        lean = generator.normal(0, np.radians(line.sigma_direction_deg), 2)
        shift = generator.normal(0, line.sigma_position_mm, 2) if name == "table_axis" else (0.0, 0.0)
        lines[name] = line.model_copy(
            update={"direction": (lean[0], lean[1], 1.0), "point_mm": (float(shift[0]), float(shift[1]), 0.0)}
        )
    return cal.model_copy(update=lines)


def world(seed: int, spec: AlignSpec) -> tuple[Alignment, np.ndarray]:
    """One alignment in a world of its own, and the true offsets (n, 2) hole minus stud at its target, mm."""
    generator = np.random.default_rng(seed)
    cal = calibration()
    true = _true_axes(cal, generator)
    rotor_pose = pose(*generator.normal(0, 0.1, 2), HEIGHT, generator.uniform(-1, 1), True)
    shaft_pose = pose(*generator.normal(0, 2, 2), 0.0, generator.uniform(-4, 4))
    places = generator.normal(0, PLACE_MM, (2, 36, 2))
    seen = places + generator.normal(0, NOISE_MM, (2, 36, 2))
    rotor = measurement(
        "stud", _wrong_view(cal, "rotor", generator) @ rotor_pose, MIRRORED, errors=seen[0], sigma_mm=NOISE_MM
    )
    shaft = measurement(
        "hole", _wrong_view(cal, "shaft", generator) @ shaft_pose, ANGLES, errors=seen[1], sigma_mm=NOISE_MM
    )
    home = AxesPosition(0.0, 0.0, 0.0, 0.0)
    found = align(rotor, shaft, cal, home, spec)
    stage = cal.stage
    aside = np.hypot(stage.sigma_position_mm, cal.jack_line.sigma_position_mm)
    reached = replace(
        found.target,
        x_mm=found.target.x_mm + generator.normal(0, aside),
        y_mm=found.target.y_mm + generator.normal(0, aside),
        theta_deg=found.target.theta_deg + generator.normal(0, stage.sigma_table_deg),
    )
    docked = shaft_at(true, shaft_pose, home, reached)
    nominal = np.radians(np.array(ANGLES))
    ring = 120.0 * np.stack([np.cos(nominal), np.sin(nominal)], axis=1)
    flipped = ring * [1.0, -1.0]
    holes = np.column_stack([ring + places[1], np.zeros(36)]) @ docked[:3, :3].T + docked[:3, 3]
    studs = np.column_stack([flipped + places[0], np.zeros(36)]) @ rotor_pose[:3, :3].T + rotor_pose[:3, 3]
    return found, (holes - studs)[:, :2]


def test_predicted_and_observed_odds_agree_where_they_are_uncertain() -> None:
    """Clearances from tight to roomy, so that the odds run from almost none to almost sure."""
    spec = replace(
        align_spec(RECIPE), samples=4096, hole_depth_mm=0.0, stud_length_mm=0.0, heated=None, difference_k=0.0
    )
    predicted, free = [], []
    for seed in range(2000, 2080):
        room = (0.048, 0.058, 0.068, 0.085)[seed % 4]
        found, offsets = world(seed, replace(spec, clearance_mm=room))
        predicted.append(found.p_insert)
        free.append(bool(np.linalg.norm(offsets, axis=1).max() < room))
    odds, seen = np.array(predicted), np.array(free, dtype=np.float64)
    assert odds.min() < 0.3 and odds.max() > 0.85
    spread = np.sqrt(np.sum(odds * (1 - odds))) / len(odds)
    assert abs(seen.mean() - odds.mean()) < 3.0 * spread
    slope = np.polyfit(odds, seen, 1)[0]
    assert 0.6 < slope < 1.5
