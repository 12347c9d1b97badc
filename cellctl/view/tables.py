"""The numbers of a measured part as HTML tables: features, face and quality, residuals by surface. Pure, text out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from cellctl.vision.geometry import inverse, transform
from cellctl.vision.part import FeatureFit, PartMeasurement
from cellctl.vision.residuals import NONE, SURFACES, Residuals

FEATURE_HEAD = ("", "x mm", "y mm", "radius mm", "sigma µm", "residual µm", "points")
ALIGNMENT = {
    "theta_deg": ("theta to go", "°", 4), "x_mm": ("x to go", "mm", 4), "y_mm": ("y to go", "mm", 4),
    "tilt_deg": ("tilt of the faces", "°", 4), "gap_mm": ("gap", "mm", 3),
    "sigma_theta_deg": ("sigma of theta", "°", 4), "sigma_xy_mm": ("sigma of x and y", "mm", 4),
    "p_insert": ("probability that all studs enter", "", 4),
    "predicted_peak_force_n": ("predicted peak force", "N", 2),
}  # fmt: skip


def feature_table(measured: PartMeasurement) -> str:
    """One row a feature, in the part frame; a missing one says why. Its button marks the feature in the picture."""
    into = inverse(measured.T_frame_part)
    rows = "".join(_feature(measured.feature, feature, into) for feature in measured.features)
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in (measured.feature, *FEATURE_HEAD[1:]))
    caption = (
        "<caption>Centre on the face in the part frame; sigma of the centre in the face (2-D); residual as the fit "
        "left it</caption>"
    )
    return f'<div class="scroll"><table class="features">{caption}<tr>{head}</tr>{rows}</table></div>'


def _feature(kind: str, feature: FeatureFit, into: Any) -> str:
    name = f"{kind} {feature.index}"
    button = f'<button type="button" aria-pressed="false" aria-label="mark {name}">{feature.index}</button>'
    if feature.center_mm is None or feature.covariance_mm2 is None:
        cells = f'<td colspan="6">missing: {escape(feature.reason)}</td>'
        return f'<tr class="missing" data-index="{feature.index}"><th scope="row">{button}</th>{cells}</tr>'
    x, y, _ = transform(into, feature.center_mm)
    spread = (into[:3, :3] @ feature.covariance_mm2 @ into[:3, :3].T)[:2, :2]
    sigma_mm = float(np.sqrt(np.trace(spread)))
    shown = (
        number(float(x), 4), number(float(y), 4), number(feature.radius_mm, 4), number(1000.0 * sigma_mm, 1),
        number(1000.0 * feature.residual_mm, 1), str(feature.points),
    )  # fmt: skip
    cells = "".join(f"<td>{cell}</td>" for cell in shown)
    return f'<tr data-index="{feature.index}"><th scope="row">{button}</th>{cells}</tr>'


def missing_list(measured: PartMeasurement) -> str:
    """What was not found and why, or that everything was."""
    kind, count = measured.feature, len(measured.features)
    missing = [feature for feature in measured.features if not feature.found]
    if not missing:
        return f'<p class="found">all {count} {kind}s found</p>'
    items = "".join(f"<li>{kind} {feature.index} is missing: {escape(feature.reason)}</li>" for feature in missing)
    return f'<p class="found">{measured.found} of {count} {kind}s found</p><ul class="missing">{items}</ul>'


def part_facts(measured: PartMeasurement) -> list[tuple[str, str]]:
    """Face, pattern, thread and quality as label and value with its unit."""
    face, quality = measured.face, measured.quality
    clocking = "free, " if measured.clocking_free else ""
    facts = [
        (f"{measured.feature}s found", f"{measured.found} of {len(measured.features)}"),
        (
            "circle diameter",
            f"{measured.circle_diameter_mm:.4f} ± {number(quality.get('sigma_circle_mm', np.nan), 4)} mm",
        ),
        ("clocking", f"{clocking}sigma {measured.sigma_clocking_deg:.5f}°"),
        ("pattern, rms", f"{number(1000.0 * quality.get('pattern_rms_mm', np.nan), 1)} µm"),
        ("face noise", f"{1000.0 * face.sigma_mm:.1f} µm"),
        ("face flatness", f"{1000.0 * face.flatness_mm:.1f} µm"),
        ("face points", f"{face.points:,}, {100.0 * face.inliers:.1f} % of them kept"),
        ("face seen", f"{number(100.0 * quality.get('coverage', np.nan), 1)} %"),
        ("distance of the scanner", f"{number(quality.get('distance_mm', np.nan), 1)} mm"),
        ("point spacing", f"{number(quality.get('spacing_mm', np.nan), 3)} mm"),
        ("points in the cloud", f"{quality.get('points', np.nan):,.0f}"),
        ("fewest points on a feature", f"{quality.get('min_points_per_feature', np.nan):.0f}"),
    ]
    thread = next((feature.thread for feature in measured.features if feature.thread is not None), None)
    if thread is not None:
        starts = "1 start" if thread.starts == 1 else f"{thread.starts} starts"
        radius = f"radius {thread.radius_mm:.4f} ± {thread.sigma_radius_mm:.4f} mm"
        pitch = f"pitch {thread.pitch_mm:.5f} ± {thread.sigma_pitch_mm:.5f} mm"
        facts.append(("thread", f"{radius}, {pitch}, {thread.hand}-hand, {starts}"))
    return facts


def surface_table(seen: Residuals) -> str:
    """How far the points of the whole cloud lie off each surface."""
    rows = []
    for kind, name in enumerate(SURFACES):
        off = 1000.0 * seen.distance_mm[seen.surface == kind].astype(np.float64)
        if len(off):
            rows.append(
                (name, f"{len(off):,}", number(float(np.sqrt(np.mean(off**2))), 1), number(float(off.mean()), 2))
            )
    rows.append(("not used", f"{np.count_nonzero(seen.surface == NONE):,}", "", ""))
    return table(("surface", "points", "rms µm", "mean µm"), rows)


def alignment_tables(alignment: Mapping[str, Any]) -> str:
    """What the shaft has to move, and the clearance that each stud would keep."""
    rows = [
        (label, f"{number(alignment[name], digits)} {unit}".strip())
        for name, (label, unit, digits) in ALIGNMENT.items()
        if name in alignment
    ]
    if alignment.get("clocking_free"):
        rows.append(("clocking", "free"))
    cold, hot = alignment.get("clearance_mm") or [], alignment.get("clearance_hot_mm") or []
    if not cold:
        return facts_table(rows)
    rows.append(("least clearance, cold", f"{number(min(cold), 4)} mm"))
    studs = [
        (str(index), number(each, 4), number(hot[index], 4) if index < len(hot) else "")
        for index, each in enumerate(cold)
    ]
    clearances = table(("stud", "cold mm", "at docking temperature mm"), studs)
    return (
        f"{facts_table(rows)}<details><summary>Clearance of each stud</summary>"
        f'<div class="scroll">{clearances}</div></details>'
    )


def facts_table(facts: Sequence[tuple[str, str]]) -> str:
    """Label and value, a row each."""
    rows = "".join(f'<tr><th scope="row">{escape(label)}</th><td>{escape(value)}</td></tr>' for label, value in facts)
    return f'<table class="facts">{rows}</table>'


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A plain table whose first column names the row."""
    top = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>' + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:]) + "</tr>"
        for row in rows
    )
    return f"<table><tr>{top}</tr>{body}</table>"


def number(value: float | None, digits: int) -> str:
    """A number with so many decimals, a dash where there is none."""
    return f"{value:.{digits}f}" if value is not None and np.isfinite(value) else "–"
