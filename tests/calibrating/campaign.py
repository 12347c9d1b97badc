"""Calibration of perturbed twins: normalised errors of every estimate against the truth, docks before and after.

``python -m tests.calibrating.campaign estimates|docks --seeds 40 --points 100000 [--figures FOLDER]`` prints one JSON
document and puts it into `FOLDER/calibration.json` with command, commit and machine.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import Calibration, Procedure
from cellctl.dock_runner import DockRequest, dock_by_sight
from cellctl.recipe import Recipe, load_recipe
from cellctl.runner import with_twin
from cellctl.studies.calibration import nees
from cellctl.studies.figures import provenance
from cellctl.twin import twin_of
from hal.config import CellConfig, load_cell
from hal.fake.parts import CellTruth
from hal.fake.plant import Plant
from hal.fake.stack import jack_errors
from hal.jobs import InlineJobs
from tests.calibrating.perturbed import ALL, believing, calibrated, overridden, perturbations
from tests.journeys.twin_runs import CELL, RECIPE, ROOT

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Error:
    """Estimate minus truth (k,) with the covariance (k, k) that was stated for it."""

    error: Array
    covariance: Array


def errors_of(found: Calibration, plant: Plant, procedures: tuple[Procedure, ...] = ALL) -> dict[str, Error]:
    """Every estimate against the plant's truth. Turns in degrees, places in mm, force in newton."""
    errors: dict[str, Error] = {}
    if "camera" in procedures:
        for view in ("rotor", "shaft"):
            errors[f"{view}_view"] = _view(found, plant, view)
        errors["common_frame"] = _common_frame(errors["rotor_view"], errors["shaft_view"], found)
    if "axes" in procedures:
        errors |= _axes(found, plant)
    if "force" in procedures:
        gain = found.jack_force
        true_offset = plant.numbers.properties.force_offset_n
        off = np.array([gain.gain - 1.0 / plant.cell.force_gain, gain.offset_n - true_offset])
        errors["force"] = Error(off, np.diag([gain.sigma_gain, gain.sigma_offset_n]) ** 2)
    return errors


def _view(found: Calibration, plant: Plant, view: str) -> Error:
    belief, true = found.views[view].matrix, plant.T_cell_camera(view)
    turn = belief[:3, :3] @ true[:3, :3].T
    vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return Error(np.array([*np.degrees(vector), *(belief[:3, 3] - true[:3, 3])]), _matrix(found.views[view].covariance))


def _common_frame(rotor: Error, shaft: Error, found: Calibration) -> Error:
    """Rotor's view against the shaft's: turns (deg), and what shifts the two faces sideways against each other (mm)."""
    error, covariance = np.zeros(5), np.zeros((5, 5))
    for sign, view, one, height in ((1.0, "rotor", rotor, 400.0), (-1.0, "shaft", shaft, 0.0)):
        x, y, z = np.radians(1.0) * (np.array([0.0, 0.0, height]) - found.views[view].matrix[:3, 3])
        seen = np.zeros((5, 6))
        seen[:3, :3] = np.eye(3)
        seen[3:] = [[0.0, z, -y, 1.0, 0.0, 0.0], [-z, 0.0, x, 0.0, 1.0, 0.0]]
        error += sign * seen @ one.error
        covariance += seen @ one.covariance @ seen.T
    return Error(error, covariance)


def _axes(found: Calibration, plant: Plant) -> dict[str, Error]:
    cell, axis, jack = plant.cell, found.table_axis, found.jack_line
    # A table whose centre walks on a circle turns about that circle's middle.
    place = axis.point_mm[:2] - (cell.table_point_mm[:2] - cell.runout_mm)
    table = Error(np.array([*place, *_turns(axis.direction, cell.table_direction)]), _matrix(axis.covariance))
    line = Error(_turns(jack.direction, _jack_direction(cell, plant)), _matrix(jack.covariance)[2:, 2:])
    sides = ("x_direction", "y_direction")
    stage = [_about_z(getattr(found.stage, side), true) for side, true in zip(sides, cell.stage, strict=True)]
    return {
        "table_axis": table,
        "jack_line": line,
        "stage": Error(np.array(stage), np.eye(2) * found.stage.sigma_direction_deg**2),
    }


def _jack_direction(cell: CellTruth, plant: Plant) -> Array:
    """Of the least-squares line through the start of the true path."""
    heights = np.linspace(0.0, plant.bench.rotor_face_mm, 9)
    drift, _ = jack_errors(cell, heights, plant.bench.jack_stroke_mm)
    return np.array([*(heights @ drift / (heights @ heights)), 1.0])


def _turns(direction: Array, true: Array) -> Array:
    """(2,) turns in degrees about cell x and y that carry `true` into `direction`."""
    lean = [np.array(one)[:2] / one[2] for one in (direction, true)]
    x, y = np.degrees(lean[0] - lean[1])
    return np.array([-y, x])


def _about_z(direction: tuple[float, float, float], true: Array) -> float:
    return float(np.degrees(true[0] * direction[1] - true[1] * direction[0]))


def _matrix(rows: tuple[tuple[float, ...], ...] | None) -> Array:
    assert rows is not None
    return np.array(rows)


def plant_of(config: CellConfig, recipe: Recipe, seed: int) -> Plant:
    """The truth that the calibration of that seed is made on."""
    return twin_of(recipe, config, InlineJobs(), seed=seed).plant


def campaign(seeds: int, points: int, looks: int = 6) -> dict[str, object]:
    """Normalised errors (1 expected), rms errors and stated sigmas over `seeds` perturbed twins, nominal level."""
    recipe, base = load_recipe(RECIPE), with_twin(load_cell(CELL), points=points)
    gathered: dict[str, list[Error]] = {}
    for seed in range(seeds):
        config = overridden(base, perturbations(np.random.default_rng(seed)))
        found = calibrated(config, recipe, seed, looks=looks)
        for name, error in errors_of(found, plant_of(config, recipe, seed)).items():
            gathered.setdefault(name, []).append(error)
    return {"seeds": seeds, "points": points, "looks": looks, **{name: _told(all_) for name, all_ in gathered.items()}}


def _told(errors: list[Error]) -> dict[str, object]:
    values = np.array([one.error for one in errors])
    covariances = np.array([one.covariance for one in errors])
    normalised = nees(values, covariances)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2).mean(axis=0))
    return {
        "nees": round(float(normalised.mean()), 3),
        "nees_error": round(float(normalised.std(ddof=1) / np.sqrt(len(normalised))), 3),
        "rms_error": [float(f"{value:.3g}") for value in np.sqrt(np.mean(values**2, axis=0))],
        "stated_sigma": [float(f"{value:.3g}") for value in sigma],
    }


def docks(seeds: int, points: int) -> dict[str, object]:
    """Docks by sight: on twins as they are drawn, on perturbed ones as they are believed, and calibrated before."""
    recipe, base = load_recipe(RECIPE), with_twin(load_cell(CELL), points=points)
    done = {name: [0, 0] for name in ("nominal", "perturbed", "calibrated")}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(seeds):
            config = overridden(base, perturbations(np.random.default_rng(seed)))
            found = believing(config, calibrated(config, recipe, seed), Path(folder))
            for name, cell in (("nominal", base), ("perturbed", config), ("calibrated", found)):
                outcome = dock_by_sight(DockRequest(recipe, cell, seed))
                done[name][0] += outcome.succeeded
                done[name][1] += bool(outcome.refused)
    return {"seeds": seeds, "points": points} | {
        name: {"succeeded": succeeded, "refused": refused} for name, (succeeded, refused) in done.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("estimates", "docks"))
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--figures", type=Path)
    args = parser.parse_args()
    began = time.process_time()
    found = (campaign if args.what == "estimates" else docks)(args.seeds, args.points)
    command = f"python -m tests.calibrating.campaign {args.what} --seeds {args.seeds} --points {args.points}"
    entry = {**provenance(command.split(), ROOT), "cpu_s": round(time.process_time() - began), **found}
    print(json.dumps(entry, indent=1))
    if args.figures is not None:
        path = args.figures / "calibration.json"
        others = json.loads(path.read_text()) if path.exists() else []
        kept = [other for other in others if other["command"] != entry["command"]]
        path.write_text(json.dumps([*kept, entry], indent=1) + "\n")


if __name__ == "__main__":
    main()
