"""One HTML file that shows measured parts: points coloured by residual, what was fitted, and every number of it.

Whole in itself: script and style stand inside, the cloud as base64, and its policy forbids to load anything.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from cellctl.view.cloud import chosen, packed
from cellctl.view.tables import alignment_tables, facts_table, feature_table, missing_list, part_facts, surface_table
from cellctl.vision.geometry import Array, Points
from cellctl.vision.part import Part, PartMeasurement
from cellctl.vision.residuals import FACE, Residuals, Shapes, residuals
from cellctl.vision.zones import rims

POINTS = 200_000
"""Most points in a page, both sides together: 9 bytes each, 2.4 MB as base64."""
SCRIPTS = ("camera.js", "points.js", "viewer.js")
ROUND_UM = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)


@dataclass(frozen=True, slots=True)
class Look:
    """One measured side: the cloud (..., 3) in the scanner's frame, NaN where invalid, and the pose (4, 4) that the
    measurement was made with, None without one. `source` says where the cloud is from."""

    side: str
    measured: PartMeasurement
    part: Part
    points: Points
    T_frame_scanner: Array | None = None
    source: str = ""


def page(
    looks: Sequence[Look],
    rng: np.random.Generator,
    *,
    title: str = "Measured parts",
    facts: Sequence[tuple[str, str]] = (),
    alignment: Mapping[str, Any] | None = None,
) -> str:
    """The page. `rng` draws which points of the plain face are shown, `alignment` holds the fields of `Alignment`."""
    budget = POINTS // max(len(looks), 1)
    drawn = [_side(look, budget, rng) for look in looks]
    data = json.dumps([numbers for numbers, _ in drawn], allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    body = "".join(section for _, section in drawn)
    joined = f"<section><h2>Alignment</h2>{alignment_tables(alignment)}</section>" if alignment else ""
    script, style = "".join(map(_static, SCRIPTS)), _static("page.css")
    script = f'(() => {{\n"use strict";\n{script}}})();\n'
    policy = f"default-src 'none'; style-src 'unsafe-inline'; script-src '{_hash(script)}'"
    head = (
        f'<meta charset="utf-8"><meta http-equiv="Content-Security-Policy" content="{policy}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{style}</style>"
    )
    top = f"<header><h1>{escape(title)}</h1>{facts_table(facts) if facts else ''}</header>"
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head><body>{top}{_static("controls.html")}'
        f'<main><div class="sides">{body}</div>{joined}</main>'
        f'<script type="application/json" id="data">{data}</script><script>{script}</script></body></html>\n'
    )


def _side(look: Look, budget: int, rng: np.random.Generator) -> tuple[dict[str, Any], str]:
    """What the script draws of one side, and its section of the page."""
    flat = look.points.reshape(-1, 3)
    seen = residuals(flat[np.isfinite(flat[:, 0])], look.measured, look.part, look.T_frame_scanner)
    cloud = packed(seen, chosen(seen, budget, rng))
    shapes = Shapes.of(look.measured, look.part)
    numbers = {
        "side": look.side,
        "count": cloud.count,
        "step": cloud.step_mm,
        "points": cloud.points,
        "surfaces": cloud.surfaces,
        "face": _face(look.part, seen, shapes),
        "features": _features(look, shapes),
        "range_um": _range_um(look.measured.face.sigma_mm),
    }
    shown = f"{cloud.count:,} of {len(seen.surface):,} points are drawn: every one at a feature where there is room, "
    name, kind = escape(look.side), look.measured.feature
    section = (
        f'<section class="side" aria-label="{name}"><h2>{name.capitalize()}</h2>'
        f'<p class="source">{escape(look.source)}</p>{missing_list(look.measured)}'
        f"{_static('picture.html').replace('SIDE', name).replace('KIND', kind)}"
        f'<p class="drawn">{shown}a random share of the others.</p>'
        f'<div class="numbers"><div><h3>Features</h3>{feature_table(look.measured)}</div>'
        f"<div><h3>Residuals of the whole cloud</h3>{surface_table(seen)}"
        f"<h3>Face and quality</h3>{facts_table(part_facts(look.measured))}</div></div></section>"
    )
    return numbers, section


def _features(look: Look, shapes: Shapes) -> list[dict[str, Any]]:
    """Place, size and reach of every feature in the part frame; a missing one where it should be."""
    part = look.part
    usual = float(np.median(shapes.mouth))
    end = (part.length_mm or 8.0 * usual) if part.feature == "stud" else -(part.depth_mm or 2.0 * usual)
    return [
        {
            "index": feature.index,
            "found": bool(shapes.found[feature.index]),
            "centre": shapes.centre[feature.index].tolist(),
            "slopes": shapes.slopes[feature.index].tolist(),
            "radius": float(feature.radius_mm or shapes.mouth[feature.index]),
            "mouth": float(shapes.mouth[feature.index]),
            "end": end,
            "reason": feature.reason,
        }
        for feature in look.measured.features
    ]


def _face(part: Part, seen: Residuals, shapes: Shapes) -> list[float]:
    """Inner and outer radius of the face: as drawn, else as far as its points reach."""
    inner, outer = rims(part, shapes.mouth)
    on = seen.local_mm[seen.surface == FACE]
    if len(on):
        rho = np.hypot(on[:, 0], on[:, 1])
        low, high = np.percentile(rho, [0.5, 99.5])
        inner = inner if part.face_inner_diameter_mm is not None else float(low)
        outer = outer if part.face_outer_diameter_mm is not None else float(high)
    return [inner, outer]


def _range_um(sigma_mm: float) -> int:
    """End of the colour scale: three sigma of the face, a round number."""
    return next((value for value in ROUND_UM if value >= 3000.0 * sigma_mm), ROUND_UM[-1])


def _static(name: str) -> str:
    return files("cellctl.view").joinpath("static").joinpath(name).read_text(encoding="utf-8")


def _hash(script: str) -> str:
    return "sha256-" + b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
