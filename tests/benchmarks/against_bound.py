"""Accuracy against the bound: random joints, rms over clouds, each error in units of that cloud's own bound.

`python -m tests.benchmarks.against_bound --clouds 100 --points 100000 --first 0` prints one line.
"""

from __future__ import annotations

import argparse
import json
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import inverse, transform
from cellctl.vision.measure import measure_part
from cellctl.vision.part import PartMeasurement, Refused
from tests.vision.bound import bound
from tests.vision.joints import random_view
from tests.vision.synthetic import View, render, true_centres

Array = NDArray[np.float64]
TILT_RAD = float(np.radians(0.02))


def over_seeds(points: int, clouds: int, first: int, tilt_rad: float = TILT_RAD) -> dict[str, Any]:
    """Ratios to the bound with 95 % bootstrap intervals, offset of the face in um, and clouds that were not whole."""
    gathered: dict[str, list[float]] = defaultdict(list)
    incomplete, refused = [], []
    for seed in range(first, first + clouds):
        rng = np.random.default_rng(seed)
        view = random_view(rng, points)
        if tilt_rad == 0.0:
            view = View(**{name: getattr(view, name) for name in View.__dataclass_fields__} | {"tilts_rad": None})
        try:
            measured = measure_part(render(view, rng), view.part)
        except Refused as error:
            refused.append({"seed": seed, "code": error.code})
            continue
        if measured.found != view.part.count:
            incomplete.append(seed)
        for name, value in squares(view, measured, tilt_rad).items():
            gathered[name].append(value)
    rng = np.random.default_rng(0)
    ratios = {name: _ratio(np.array(values), rng) for name, values in gathered.items()}
    return {"points": points, "seeds": [first, first + clouds - 1], "lean_deg": float(np.degrees(tilt_rad)),
            "ratios": ratios, "incomplete": incomplete, "refused": refused}  # fmt: skip


def squares(view: View, measured: PartMeasurement, tilt_rad: float) -> dict[str, float]:
    """Squared errors of one cloud over the square of their bound; the offset in um^2."""
    best = bound(view, tilt_rad or 1e-9)
    into = inverse(view.T_scanner_part)
    centres = np.array([transform(into, f.center_mm) for f in measured.features if f.center_mm is not None])
    radii = np.array([f.radius_mm for f in measured.features if f.center_mm is not None])
    truth = true_centres(view)
    # where no index fixes the numbers, the nearest hole is the one that was measured
    nearest = np.hypot(*(centres[:, None, :2] - truth[None, :, :2]).transpose(2, 0, 1)).argmin(axis=1)
    miss = centres[:, :2] - truth[nearest, :2]
    sizes = 0.5 * np.asarray(view.part.diameter_mm)[nearest]
    turn = _turn(truth[nearest, :2], centres[:, :2])
    normal = into[:3, :3] @ measured.face.normal
    offset = float((transform(into, measured.face.point_mm))[2])
    return {
        "hole_centre": float((miss**2).sum(axis=1).mean()) / best.centre_mm**2,
        "hole_radius": float(((radii - sizes) ** 2).mean()) / best.radius_mm**2,
        "clocking": float(np.degrees(turn) ** 2) / best.clocking_deg**2,
        "face_normal": float(np.degrees(np.hypot(*normal[:2])) ** 2 / 2.0) / best.normal_deg**2,
        "face_offset_um": (1e3 * offset) ** 2,
        "worst_centre_um": float(1e3 * np.hypot(*miss.T).max()) ** 2,
    }


def _turn(truth: Array, measured: Array) -> float:
    """Rotation (rad) of the measured centres (n, 2) against the true ones."""
    a, b = truth - truth.mean(axis=0), measured - measured.mean(axis=0)
    return float(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum()))


def _ratio(values: Array, rng: np.random.Generator) -> dict[str, float]:
    draws = np.sqrt(values[rng.integers(0, len(values), (2000, len(values)))].mean(axis=1))
    low, high = np.quantile(draws, [0.025, 0.975])
    return {"rms": float(np.sqrt(values.mean())), "low": float(low), "high": float(high),
            "worst": float(np.sqrt(values.max()))}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.against_bound", description=__doc__)
    parser.add_argument("--points", type=int, default=100_000)
    parser.add_argument("--clouds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--square", action="store_true", help="holes stand square, and the bound knows it")
    args = parser.parse_args(argv)
    print(json.dumps(over_seeds(args.points, args.clouds, args.first, 0.0 if args.square else TILT_RAD)))


if __name__ == "__main__":
    main()
