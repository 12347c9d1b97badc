"""The page of `cellctl measure --view`: each part's features on its face, drawn to scale. One file, no scripts."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

import numpy as np

STYLE = (
    "body{font:14px system-ui,sans-serif;margin:2em;max-width:60em}table{border-collapse:collapse}"
    "td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ccc}svg{max-width:36em;width:100%}"
    ".found{fill:#dbeafe;stroke:#1d4ed8}.lost{fill:none;stroke:#b91c1c;stroke-dasharray:2 1}"
)


def write_view(path: Path, document: dict[str, Any]) -> None:
    """Write the page of a `measure` document. Raises OSError."""
    body = "".join(_part(side, document[side]) for side in ("rotor", "shaft") if side in document)
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Measured parts</title>'
        f"<style>{STYLE}</style></head><body><h1>Measured parts</h1>{body}</body></html>"
    )
    path.write_text(page, encoding="utf-8")


def _part(side: str, part: dict[str, Any]) -> str:
    inverse = np.linalg.inv(np.array(part["T_frame_part"]))
    size = 0.65 * part["circle_diameter_mm"]
    marks, rows = [], []
    for feature in part["features"]:
        if not feature["found"]:
            rows.append(f"<tr><td>{feature['index']}</td><td colspan=4>missing: {escape(feature['reason'])}</td></tr>")
            continue
        u, v, _ = (inverse @ np.append(feature["center_mm"], 1.0))[:3]
        radius = feature["radius_mm"] or 0.01 * size
        sigma = 1000.0 * float(np.sqrt(np.trace(np.array(feature["covariance_mm2"]))))
        marks.append(f'<circle class="found" cx="{u:.3f}" cy="{-v:.3f}" r="{radius:.3f}"/>')
        marks.append(
            f'<text x="{0.88 * u:.2f}" y="{-0.88 * v:.2f}" font-size="{0.03 * size:.1f}">{feature["index"]}</text>'
        )
        rows.append(
            f"<tr><td>{feature['index']}</td><td>{u:.4f}</td><td>{v:.4f}</td><td>{radius:.4f}</td><td>{sigma:.1f}</td></tr>"
        )
    ring = 0.5 * part["circle_diameter_mm"]
    return (
        f"<h2>{escape(side)}</h2>"
        f'<svg viewBox="{-size:.1f} {-size:.1f} {2 * size:.1f} {2 * size:.1f}" stroke-width="{0.003 * size:.3f}">'
        f'<circle r="{ring:.3f}" fill="none" stroke="#aaa"/>{"".join(marks)}</svg>'
        f"<p>Circle {part['circle_diameter_mm']:.4f} mm, flatness {part['face']['flatness_mm']:.4f} mm, "
        f"noise {part['face']['sigma_mm']:.4f} mm, clocking &plusmn; {part['sigma_clocking_deg']:.5f} deg.</p>"
        "<table><tr><th>no.</th><th>x mm</th><th>y mm</th><th>radius mm</th><th>sigma um</th></tr>"
        f"{''.join(rows)}</table>"
    )
