"""Studs against their bound: `python -m tests.vision.stud_campaign --clouds 100 --seed 1`.

Joints, views and noise are drawn at random (`stud_scene.random_scene`); one cloud in four lacks a stud. Printed and
written to docs/figures/stud_accuracy.json: rms error over the bound of the same cloud, with its 95 % interval.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from cellctl.studies.figures import provenance
from cellctl.vision.measure import measure_part
from cellctl.vision.part import PartMeasurement, Refused, Thread
from cellctl.vision.thread import fit_thread
from tests.vision.bound_studs import Bound, close_up_bound, pattern_fisher, scene_bound
from tests.vision.stud_scene import Errors, Scene, incidence, random_scene, spoil, trace
from tests.vision.thread_scene import Bolt, close_up

Array = NDArray[np.float64]

ROOT = Path(__file__).parents[2]
SEEN_MM = 0.02
"""A bound on the radius above this: the crests do not show, and the radius is not judged."""
WRONG_MM = 0.5
POINTS = (100_000, 300_000, 1_000_000)
CLOSE_UP = 20_000


@dataclass
class Tally:
    """Errors over their bounds (z) by quantity, and what was found."""

    z: dict[str, list[float]] = field(default_factory=dict)
    clouds: int = 0
    studs: int = 0
    found: int = 0
    invented: int = 0
    refused: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)

    def add(self, name: str, values: Sequence[float] | Array) -> None:
        """Errors over their bound."""
        self.z.setdefault(name, []).extend(float(value) for value in values)

    def summary(self) -> dict[str, Any]:
        """Plain data: rms of each z with its 95 % interval."""
        ratios = {name: interval(np.array(values)) for name, values in sorted(self.z.items())}
        counts = {"clouds": self.clouds, "studs": self.studs, "found": self.found, "invented": self.invented}
        return counts | {"refused": self.refused, "missed": self.missed, "rms_over_bound": ratios}


def interval(z: Array) -> dict[str, float]:
    """Rms of values and its 95 % interval were they normal."""
    rms, n = float(np.sqrt(np.mean(z**2))), len(z)
    low, high = (rms * float(np.sqrt(n / chi2.ppf(p, n))) for p in (0.975, 0.025))
    return {"rms": round(rms, 3), "low": round(low, 3), "high": round(high, 3), "n": n}


def random_errors(rng: np.random.Generator) -> Errors:
    """White noise along the ray, the same everywhere or the same across the surface."""
    if rng.random() < 0.5:
        return Errors(growth=1.0, steep_deg=float(rng.uniform(75.0, 82.0)), outliers=float(rng.uniform(0.02, 0.06)))
    return Errors(growth=0.0, steep_deg=float(rng.uniform(75.0, 90.0)), outliers=float(rng.uniform(0.02, 0.06)))


def flange(seed: int, points: int, tally: Tally, errors: Errors | None = None) -> None:
    """One random joint, rendered, measured and compared with its bound."""
    rng = np.random.default_rng([seed, points])
    scene = random_scene(rng, points, errors=errors or random_errors(rng))
    part = scene.part
    if rng.random() < 0.25 and part.count > 8:
        kept = np.delete(np.arange(part.count), rng.integers(part.count))
        scene = replace(
            scene, bolts=tuple(scene.bolts[i] for i in kept), places=scene.places[kept], leans=scene.leans[kept]
        )
    traced = trace(scene)
    cloud, good = spoil(scene, *traced, rng)
    tally.clouds += 1
    tally.studs += len(scene.bolts)
    try:
        measured = measure_part(cloud, part)
    except Refused as refused:
        tally.refused.append(f"seed {seed}: {refused}")
        return
    found = tally.found
    compare(scene, measured, scene_bound(scene, *traced, good=good), tally)
    if tally.found - found < len(scene.bolts):
        reasons = [f"{feature.index} ({feature.reason})" for feature in measured.features if not feature.found]
        pixels = np.bincount(traced[1][traced[1] >= 0], minlength=len(scene.bolts))
        tally.missed.append(f"seed {seed}: {', '.join(reasons)}; {pixels.min()} to {pixels.max()} pixels a stud")


def compare(scene: Scene, measured: PartMeasurement, bound: Bound, tally: Tally) -> None:
    """Each found stud with the true one where it is."""
    rotation, shift = scene.T_scanner_part[:3, :3], scene.T_scanner_part[:3, 3]
    met, errors = [], []
    for feature in measured.features:
        if feature.center_mm is None:
            continue
        offsets = (rotation.T @ (feature.center_mm - shift))[:2] - scene.places
        nearest = int(np.argmin(np.hypot(*offsets.T)))
        if np.hypot(*offsets[nearest]) > WRONG_MM or nearest in met:
            tally.invented += 1
            continue
        met.append(nearest)
        errors.append(offsets[nearest])
    tally.found += len(met)
    offset = np.array(errors)
    tally.add("place", (offset / bound.place_mm[met]).ravel())
    design, fisher = pattern_fisher(scene.places[met], bound.place_covariance_mm2[met])
    turn = np.linalg.solve(fisher.sum(axis=0), np.einsum("nki,nij,nj->k", design, bound.place_information[met], offset))
    tally.add("clocking", [turn[2] / np.sqrt(np.linalg.inv(fisher.sum(axis=0))[2, 2])])
    thread = next((feature.thread for feature in measured.features if feature.thread is not None), None)
    if thread is not None:
        tally.add("pitch", [(thread.pitch_mm - scene.bolts[0].pitch) / bound.pitch_mm])
        if bound.radius_mm < SEEN_MM:
            tally.add("radius", [(thread.radius_mm - scene.bolts[0].radius) / bound.radius_mm])


def one_stud(seed: int, tally: Tally) -> None:
    """One stud from the side: 20,000 points, its axis not known."""
    rng = np.random.default_rng([seed, CLOSE_UP])
    errors = random_errors(rng)
    major, pitch = [(5.0, 0.8), (6.0, 1.0), (8.0, 1.0), (8.0, 1.25), (10.0, 1.5), (12.0, 1.75)][rng.integers(6)]
    starts, hand = 2 if rng.random() < 0.2 else 1, -1 if rng.random() < 0.3 else 1
    bolt = Bolt(radius=0.5 * major - rng.uniform(0.0, 0.07), pitch=pitch * (1.0 + rng.normal(0.0, 5e-4)), hand=hand,
                starts=starts, length=4.0 * major, phase=rng.random() * pitch)  # fmt: skip
    points, eye = close_up(bolt, rng, sigma=0.0, points=CLOSE_UP, elevation_deg=float(rng.uniform(0.0, 45.0)))
    depth = np.linalg.norm(points - eye, axis=1)
    rays = (points - eye) / depth[:, None]
    cosine = incidence(bolt, points, rays)
    seen = cosine > np.cos(np.radians(errors.steep_deg))
    depth, rays, cosine = depth[seen], rays[seen], cosine[seen]
    sigmas = errors.sigma_mm / np.maximum(cosine, 0.1) ** errors.growth
    radius_mm, pitch_mm = close_up_bound(bolt, eye, rays, depth, sigmas)
    noisy = depth + sigmas * rng.standard_normal(len(depth))
    wild = rng.random(len(depth)) < errors.outliers
    noisy[wild] += rng.normal(0.0, 2.0, np.count_nonzero(wild))
    nominal = Thread(major, pitch, "right" if hand > 0 else "left", starts)
    tally.clouds += 1
    tally.studs += 1
    try:
        found = fit_thread(eye + noisy[:, None] * rays, viewpoint=eye, nominal=nominal).thread
    except Refused as refused:
        tally.refused.append(f"seed {seed}: {refused}")
        return
    tally.found += 1
    tally.add("radius", [(found.radius_mm - bolt.radius) / radius_mm])
    tally.add("pitch", [(found.pitch_mm - bolt.pitch) / pitch_mm])


def main(argv: Sequence[str] | None = None) -> int:
    """The command. Exit 1 where a stud was invented or a cloud refused."""
    parser = argparse.ArgumentParser(prog="python -m tests.vision.stud_campaign", description=__doc__)
    parser.add_argument("--clouds", type=int, default=100, help="clouds of each size")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first cloud")
    parser.add_argument("--points", type=int, nargs="+", default=[*POINTS, CLOSE_UP])
    parser.add_argument("--figures", type=Path, help="file to write, as docs/figures/stud_accuracy.json")
    args = parser.parse_args(argv)
    results: dict[str, Any] = {}
    for points in args.points:
        tally = Tally()
        for seed in range(args.seed, args.seed + args.clouds):
            one_stud(seed, tally) if points == CLOSE_UP else flange(seed, points, tally)
        name = "close-up" if points == CLOSE_UP else f"flange {points}"
        results[name] = tally.summary()
        print(name, json.dumps(results[name]), flush=True)
    if args.figures is not None:
        command = ["python", "-m", "tests.vision.stud_campaign", *(sys.argv[1:] if argv is None else argv)]
        entry = provenance(command, ROOT) | {"seeds": [args.seed, args.seed + args.clouds - 1]} | results
        args.figures.write_text(json.dumps(entry, indent=1) + "\n", encoding="utf-8")
    return int(any(result["invented"] or result["refused"] for result in results.values()))


if __name__ == "__main__":
    sys.exit(main())
