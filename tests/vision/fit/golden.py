"""Reference sets with their minima: `python -m tests.vision.fit.golden` writes golden.json beside this file.

Points are rounded to a nanometre as in a certified file. The code under test has no part in the minima.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from tests.vision.fit import bands, minima, sets
from tests.vision.fit.campaign import LEAST, anywhere, in_plane, lower

FILE = Path(__file__).parent / "golden.json"
SETS = 12
SEED = 20_261


def entry(kind: str, number: int) -> dict[str, Any] | None:
    """One set; None where its minimum is not the one near the truth, so that no one can doubt which is meant."""
    rng = np.random.default_rng([SEED, number])
    drawn = sets.draw(kind, rng)
    points = np.round(drawn.points, 6)
    if len(points) > 30:
        return None
    least = minima.minimum(kind, points, drawn.truth)
    others = [minima.near_cost(kind, points, anywhere(drawn, rng)) for _ in range(10)]
    if not least.settled or any(lower(other, least.cost, len(points)) for other in others):
        return None
    result: dict[str, Any] = {"kind": kind, "family": drawn.family, "points": points.tolist()}
    result |= {"point": least.point.tolist(), "cost": least.cost}
    if least.direction is not None:
        result["direction"] = least.direction.tolist()
    if kind not in ("line", "plane"):
        result["radius"] = least.radius
    if kind == "cone":
        result["apex_rad"] = least.apex_rad
    zone = narrowest(kind, points, drawn, rng)
    return result | ({} if zone is None else {"zone": zone})


def narrowest(kind: str, points: minima.Array, drawn: sets.Drawn, rng: np.random.Generator) -> float | None:
    """Width of the minimum zone of those kinds that have one; None where it is not certain."""
    if kind == "plane":
        return bands.flatness(points)
    if kind == "circle":
        return bands.roundness(in_plane(points))
    if kind != "cylinder" or drawn.truth[1] is None:
        return None
    point, direction, *_ = drawn.truth
    found = [bands.searched(points, point, direction)]
    width, length = found[0][0], float(np.ptp((points - point) @ direction))
    for _ in range(20):
        size = width * 10.0 ** rng.uniform(-1.0, 1.0)
        aside = direction + size / length * rng.standard_normal(3)
        found.append(bands.searched(points, point + size * rng.standard_normal(3), aside / np.linalg.norm(aside)))
    best = min(found, key=lambda band: band[0])
    certified = bands.certified(points, best[1], best[2])
    return certified.width if certified.settled else None


def main() -> None:
    """Write the file, one set a line."""
    lines = []
    for kind in LEAST:
        found: list[dict[str, Any]] = []
        number = 0
        while len(found) < SETS:
            one = entry(kind, number)
            number += 1
            if one is not None:
                found.append(one)
        print(f"{kind}: {SETS} of {number} sets")
        lines += [json.dumps(one) for one in found]
    FILE.write_text("[\n" + ",\n".join(lines) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
