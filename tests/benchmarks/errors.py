"""What a pipeline returned against the truth of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import inverse, transform
from cellctl.vision.pattern import nominal, symmetry
from tests.benchmarks.scenes import Scene

Array = NDArray[np.float64]

GROSS_MM = 0.25
"""A centre that is further off belongs to no hole; ten of our sigma under the worst scan of `stressed`."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Of one scene. `centres_um` (k,) of the holes that are in view and found, in the plane of the face; `gross` counts
    centres (of any hole) beyond GROSS_MM from the nearest true one. Angles in degrees, NaN after a refusal.
    """

    seen: int
    centres_um: Array
    gross: int
    clocking_deg: float
    normal_deg: float
    refused: str = ""


def errors(result: Mapping[str, Any], scene: Scene) -> Errors:
    """A pipeline's result as JSON against the true pose. Clocking is modulo the pattern's own symmetry."""
    seen, part = int(scene.seen.sum()), scene.part
    if "refused" in result:
        return Errors(seen, np.empty(0), 0, float("nan"), float("nan"), result["refused"])
    to_part = inverse(scene.truth)
    centres = np.array([[np.nan] * 3 if one is None else one for one in result["centres"]])
    places = transform(to_part, centres[np.isfinite(centres[:, 0])])[:, :2]
    true = nominal(part)
    away = np.hypot(*(places[:, None] - true[None]).transpose(2, 0, 1))
    owner, off = away.argmin(axis=1), away.min(axis=1)
    normal = to_part[:3, :3] @ result["normal"]
    if "x_axis" in result:
        x_axis = to_part[:3, :3] @ result["x_axis"]
        clocking = float(np.degrees(np.arctan2(x_axis[1], x_axis[0])))
    else:
        clocking = turn_deg(true[owner], places)
    pitch = 360.0 / symmetry(part)
    return Errors(
        seen=seen,
        centres_um=1e3 * off[scene.seen[owner]],
        gross=int((off > GROSS_MM).sum()),
        clocking_deg=(clocking + pitch / 2) % pitch - pitch / 2,
        normal_deg=float(np.degrees(np.arctan2(np.hypot(normal[0], normal[1]), normal[2]))),
    )


def turn_deg(nominal_mm: Array, measured_mm: Array) -> float:
    """Rotation (degrees) by least squares from nominal (n, 2) to measured (n, 2), shift free."""
    a, b = nominal_mm - nominal_mm.mean(axis=0), measured_mm - measured_mm.mean(axis=0)
    return float(np.degrees(np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())))


def pooled(many: Sequence[Errors]) -> dict[str, Any]:
    """Over scenes: rms and worst of all centres, rms of the angles, counts."""
    centres = np.concatenate([one.centres_um for one in many])
    measured = [one for one in many if not one.refused]

    def rms(values: Sequence[float] | Array) -> float | None:
        return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None

    return {
        "scenes": len(many),
        "centre_rms_um": rms(centres),
        "centre_worst_um": float(centres.max()) if len(centres) else None,
        "clocking_deg": rms([one.clocking_deg for one in measured]),
        "normal_deg": rms([one.normal_deg for one in measured]),
        "found": len(centres),
        "seen": sum(one.seen for one in many),
        "gross": sum(one.gross for one in many),
        "refused": [one.refused for one in many if one.refused],
    }
