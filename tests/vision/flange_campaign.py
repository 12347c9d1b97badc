"""Hundreds of emulated flange scans: `python -m tests.vision.flange_campaign --scenes 300 --seed 1 [--figures FOLDER]`.

Every scene is drawn at random from its number and the seed, rendered, measured and compared with its truth. What came
of it is printed and put into `FOLDER/flange_campaign.json` with command, commit and machine. Exit 0 where no scan gave
a wrong pose, 3 otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cellctl.recipe import load_recipe
from cellctl.studies.figures import provenance
from cellctl.vision.geometry import inverse, transform
from cellctl.vision.measure import measure_part
from cellctl.vision.part import Part, PartMeasurement, Refused
from tests.vision.flange_scene import CENTRES, Scan, random_scan, render

ROOT = Path(__file__).parents[2]
PART: Part = load_recipe(ROOT / "recipes" / "flange_iso9409_50_4.toml").part("shaft")
LOST = (0.0, 0.03, 0.1, 0.2)
"""Limits of the classes that results are told by: the share of the face without points."""
WRONG_DEG = 5.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """One scene: `code` where it was refused, else errors against the truth; residuals are those to the nominal."""

    lost: float
    code: str = ""
    found: int = 0
    clocking_deg: float = float("nan")
    tilt_deg: float = float("nan")
    sigma_clocking_deg: float = float("nan")
    circle_mm: float = float("nan")
    sigma_circle_mm: float = float("nan")
    nominal_rms_mm: float = float("nan")

    @property
    def wrong(self) -> bool:
        """Whether a pose was given that is not the flange's."""
        return not self.code and (abs(self.clocking_deg) > WRONG_DEG or self.tilt_deg > WRONG_DEG)


def outcome(scan: Scan, cloud: np.ndarray) -> Outcome:
    """Measure one cloud (N, 3) of the scan."""
    try:
        measured = measure_part(cloud, PART)
    except Refused as refused:
        return Outcome(scan.lost, refused.code)
    return compared(scan, measured)


def compared(scan: Scan, measured: PartMeasurement) -> Outcome:
    """Errors against the truth: the clocking of the holes as drilled, the circle as drawn."""
    rotation = scan.T_scanner_part[:3, :3].T @ measured.T_frame_part[:3, :3]
    drilled = CENTRES if scan.flange.offsets_mm is None else CENTRES + scan.flange.offsets_mm
    off, drawn = drilled - drilled.mean(axis=0), CENTRES - CENTRES.mean(axis=0)
    turned = np.arctan2(np.sum(drawn[:, 0] * off[:, 1] - drawn[:, 1] * off[:, 0]), np.sum(drawn * off))
    centres = [feature.center_mm for feature in measured.features if feature.center_mm is not None]
    places = [CENTRES[feature.index] for feature in measured.features if feature.center_mm is not None]
    misses = transform(inverse(measured.T_frame_part), np.array(centres))[:, :2] - np.array(places)
    return Outcome(
        lost=scan.lost,
        found=measured.found,
        clocking_deg=float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]) - turned)),
        tilt_deg=float(np.degrees(np.arccos(np.clip(rotation[2, 2], -1.0, 1.0)))),
        sigma_clocking_deg=measured.sigma_clocking_deg,
        circle_mm=measured.circle_diameter_mm - PART.circle_diameter_mm,
        sigma_circle_mm=measured.quality["sigma_circle_mm"],
        nominal_rms_mm=float(np.sqrt(np.mean(np.sum(misses**2, axis=1)))),
    )


def scene(seed: int, number: int) -> Outcome:
    """Draw, render and measure one scene."""
    rng = np.random.default_rng([seed, number])
    scan = random_scan(rng)
    return outcome(scan, render(scan, rng))


def spread(values: Sequence[float], limit: float) -> dict[str, float]:
    """Median, 90 %, largest and the share above the limit, of absolute values."""
    sizes = np.abs(np.asarray(values, dtype=np.float64))
    if not len(sizes):
        return {}
    return {
        "median": round(float(np.median(sizes)), 4),
        "p90": round(float(np.quantile(sizes, 0.9)), 4),
        "max": round(float(sizes.max()), 4),
        f"above {limit}": round(float(np.mean(sizes > limit)), 4),
    }


def rms(values: Sequence[float]) -> float | None:
    """Root of the mean square, None where there is nothing."""
    return round(float(np.sqrt(np.mean(np.square(values)))), 3) if values else None


def summary(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """What a set of scenes came to."""
    posed = [one for one in outcomes if not one.code]
    right = [one for one in posed if not one.wrong]
    whole = [one for one in right if one.found == PART.count]
    return {
        "scenes": len(outcomes),
        "refused": dict(sorted(Counter(one.code for one in outcomes if one.code).items())),
        "wrong": len(posed) - len(right),
        "all holes found": len(whole),
        "clocking deg": spread([one.clocking_deg for one in right], 0.25),
        "clocking over sigma, rms": rms([one.clocking_deg / one.sigma_clocking_deg for one in right]),
        "circle diameter mm": spread([one.circle_mm for one in whole], 0.1),
        "circle diameter over sigma, rms": rms([one.circle_mm / one.sigma_circle_mm for one in right]),
        "hole to nominal rms mm": spread([one.nominal_rms_mm for one in whole], 0.2),
    }


def report(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """All scenes, and those of each class of lost points."""
    result = {"all": summary(outcomes)}
    for low, high in pairwise(LOST):
        result[f"{low:.0%} to {high:.0%} of the face lost"] = summary([o for o in outcomes if low <= o.lost < high])
    return result


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--figures", type=Path, default=None)
    chosen = parser.parse_args(words)
    outcomes = []
    for number in range(chosen.scenes):
        one = scene(chosen.seed, number)
        outcomes.append(one)
        if one.wrong or one.code or one.found < PART.count:
            print(f"{number}: {one.code or f'{one.found} found'}{' WRONG' if one.wrong else ''}", file=sys.stderr)
    command = f"python -m tests.vision.flange_campaign --scenes {chosen.scenes} --seed {chosen.seed}"
    entry = {**provenance([command], ROOT), **report(outcomes)}
    print(json.dumps(entry, indent=1))
    if chosen.figures is not None:
        path = chosen.figures / "flange_campaign.json"
        entries = json.loads(path.read_text(encoding="utf-8")) if path.exists() else []
        others = [other for other in entries if other["command"] != entry["command"]]
        path.write_text(json.dumps([*others, entry], indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return 3 if any(one.wrong for one in outcomes) else 0


if __name__ == "__main__":
    sys.exit(main())
