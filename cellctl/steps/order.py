"""In which order the joints are tightened. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hal.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Pair:
    """Two opposite joints: gun a takes `a`, gun b takes `b`; `table_deg` is where the gun table stands."""

    a: int
    b: int
    table_deg: float


def pairs(angles_deg: tuple[float, ...], order: Literal["star", "sequential"]) -> tuple[Pair, ...]:
    """All opposite pairs in the order of one pass.

    Star: each next pair lies as far from the ones tightened before as the pattern allows, over the half circle, as
    usual for flange joints (ASME PCC-1). Raises ConfigError where a joint has no opposite.
    """
    found = []
    for index, angle in enumerate(angles_deg):
        opposite = _opposite(angles_deg, index)
        if index < opposite:
            found.append(Pair(a=index, b=opposite, table_deg=angle % 360.0))
    return tuple(found) if order == "sequential" else tuple(found[i] for i in star(len(found)))


def star(count: int) -> tuple[int, ...]:
    """0..count-1, each next one as far as possible from those before it on the circle of `count` places."""
    left = list(range(count))
    order: list[int] = []
    distance = [count] * count
    while left:
        chosen = max(left, key=lambda i: (distance[i], -i))
        left.remove(chosen)
        order.append(chosen)
        distance = [min(far, abs(i - chosen), count - abs(i - chosen)) for i, far in enumerate(distance)]
    return tuple(order)


def _opposite(angles_deg: tuple[float, ...], index: int) -> int:
    wanted = angles_deg[index] + 180.0
    distances = [abs((angle - wanted + 180.0) % 360.0 - 180.0) for angle in angles_deg]
    best = min(range(len(distances)), key=distances.__getitem__)
    if distances[best] > 0.5 or best == index:
        raise ConfigError(
            "two opposite guns need an opposite joint for each joint",
            place=f"pattern.angles_deg[{index}]",
            limit="0.5",
            unit="deg",
        )
    return best
