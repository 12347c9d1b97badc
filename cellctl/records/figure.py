"""Plain line charts as inline SVG: no script, no style from elsewhere. Pure functions, text out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

WIDTH, HEIGHT = 640.0, 260.0
LEFT, RIGHT, TOP, BOTTOM = 60.0, 150.0, 16.0, 40.0
MOST_POINTS = 600
STROKES = ("#1b4f8a", "#b03a2e", "#2e7d32", "#6a3d9a", "#b8860b")
DASHES = ("none", "6 3", "2 3", "8 3 2 3", "1 2")
"""Lines differ by dash as well as by colour, so that the chart can be read in print."""


@dataclass(frozen=True, slots=True)
class Line:
    """One curve: a label and points of equal number; points that are not finite are left out."""

    label: str
    x: Sequence[float]
    y: Sequence[float]


def chart(lines: Sequence[Line], *, x_label: str, y_label: str, limit: float | None = None) -> str:
    """An SVG chart with ticks; `limit` is drawn as a horizontal line. Empty text where there is nothing to draw."""
    kept = [(line.label, thinned(line)) for line in lines]
    kept = [(label, points) for label, points in kept if points]
    if not kept:
        return ""
    xs = [x for _, points in kept for x, _ in points]
    ys = [y for _, points in kept for _, y in points] + ([limit] if limit is not None else [])
    x_low, x_high = _span(xs)
    y_low, y_high = _span([*ys, 0.0])

    def place(x: float, y: float) -> tuple[float, float]:
        across = LEFT + (x - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT)
        return across, HEIGHT - BOTTOM - (y - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM)

    parts = [f'<svg viewBox="0 0 {WIDTH:.0f} {HEIGHT:.0f}" role="img" aria-label="{escape(y_label)}">']
    for value in ticks(x_low, x_high):
        across, _ = place(value, y_low)
        parts.append(_text(across, HEIGHT - BOTTOM + 14, f"{value:g}", "middle"))
    for value in ticks(y_low, y_high):
        _, up = place(x_low, value)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{up:.1f}" y2="{up:.1f}" stroke="#ddd"/>')
        parts.append(_text(LEFT - 6, up + 4, f"{value:g}", "end"))
    if limit is not None:
        _, up = place(x_low, limit)
        parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{up:.1f}" y2="{up:.1f}" stroke="#000"/>')
        parts.append(_text(WIDTH - RIGHT + 6, up + 4, f"limit {limit:g}", "start"))
    for number, (label, points) in enumerate(kept):
        where = " ".join("{:.1f},{:.1f}".format(*place(x, y)) for x, y in points)
        look = f'fill="none" stroke="{STROKES[number % 5]}" stroke-dasharray="{DASHES[number % 5]}" stroke-width="1.5"'
        parts.append(f'<polyline points="{where}" {look}/>')
        up = TOP + 16 * (number + 1)
        across = WIDTH - RIGHT + 6
        parts.append(f'<line x1="{across}" x2="{across + 24}" y1="{up}" y2="{up}" {look}/>')
        parts.append(_text(across + 30, up + 4, label, "start"))
    parts.append(_text((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, x_label, "middle"))
    parts.append(_text(LEFT, TOP - 4, y_label, "middle"))
    return "".join([*parts, "</svg>"])


def thinned(line: Line) -> list[tuple[float, float]]:
    """At most MOST_POINTS finite points; of each dropped group the lowest and the highest stay, so no peak is lost."""
    points = [
        (float(x), float(y)) for x, y in zip(line.x, line.y, strict=True) if math.isfinite(x) and math.isfinite(y)
    ]
    if len(points) <= MOST_POINTS:
        return points
    size = math.ceil(2 * len(points) / MOST_POINTS)
    kept: list[tuple[float, float]] = []
    for start in range(0, len(points), size):
        group = points[start : start + size]
        kept += sorted({min(group, key=lambda p: p[1]), max(group, key=lambda p: p[1])})
    return kept


def ticks(low: float, high: float) -> list[float]:
    """Four to eight round values between `low` and `high`."""
    rough = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * factor for factor in (1, 2, 5, 10) if power * factor >= rough)
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 12) for i in range(first, math.floor(high / step + 1e-9) + 1)]


def _span(values: list[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    return (low, high) if high - low > 1e-12 * max(1.0, abs(low)) else (low - 0.5, high + 0.5)


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="11">{escape(text)}</text>'
