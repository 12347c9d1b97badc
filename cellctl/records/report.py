"""The report of a run: one plain HTML page, nothing loaded from elsewhere, made from the journal (and its curves)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

from cellctl.records.canonical import number_of
from cellctl.records.chain import Row
from cellctl.records.figure import Line, chart
from cellctl.records.summary import RunSummary, Value, summarise, typed, value_of

Curves = Callable[[str], Mapping[str, Any]]
"""Arrays of a blob by its content hash; raises RecordCorrupt where it is missing."""

STYLE = """body{font:15px/1.45 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#111}
table{border-collapse:collapse;margin:.5em 0}td,th{border:1px solid #bbb;padding:.15em .5em;text-align:left}
td.n{text-align:right;font-variant-numeric:tabular-nums}svg{max-width:46em;background:#fff}
.verdict{font-size:1.4em;border:3px solid #111;padding:.4em .8em;display:inline-block}.bad{font-weight:bold}
footer{margin-top:2em;color:#444}@media print{body{margin:0}}"""

HEADER = {
    "run_id": "Run", "job_order_id": "Job order", "rotor_serial": "Rotor", "shaft_serial": "Shaft", "cell": "Cell",
    "calibration_id": "Calibration", "recipe_hash": "Recipe content", "calibration_hash": "Calibration content",
    "software": "Software", "seed": "Seed of the twin", "level": "Level of the twin",
}  # fmt: skip

NUMBERS = {
    "x_mm": "x to go, mm", "y_mm": "y to go, mm", "theta_deg": "theta to go, deg",
    "sigma_xy_mm": "sigma of x and y, mm",
    "sigma_theta_deg": "sigma of theta, deg", "tilt_deg": "tilt of the faces, deg", "gap_mm": "gap, mm",
    "p_insert": "probability that all studs enter, cold", "p_insert_hot": "the same, hot",
    "p_force_ok": "probability that the force stays below the limit",
    "predicted_peak_force_n": "predicted peak force (95 %), N", "clocking_free": "clocking free",
    "eps_pla": "face index eps_pla", "eps_cyc": "hole index eps_cyc",
}  # fmt: skip


def report_of(rows: tuple[Row, ...], curves: Curves | None = None) -> str:
    """HTML of a run from all rows of its journal; `curves` adds the force curve that the journal names by hash."""
    run = summarise(rows)
    sections = [
        _header(value_of(rows, "run") or {}, run),
        _verdict(run),
        _phases(run),
        _alignment(value_of(rows, "alignment")),
        _insertion(rows, curves),
        _heat(rows),
        _joints(rows),
        _devices(value_of(rows, "run") or {}),
    ]
    title = escape(f"Run {run.run_id}")
    foot = f"<footer>{run.rows} rows, journal hash <code>{run.journal_hash}</code></footer>"
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title>'
    body = "".join(section for section in sections if section)
    return f'<!doctype html><html lang="en"><head>{head}<style>{STYLE}</style></head><body>{body}{foot}</body></html>\n'


def _header(head: Value, run: RunSummary) -> str:
    rows = [(label, head[key]) for key, label in HEADER.items() if head.get(key) is not None]
    rows += [("Recipe", f"{run.recipe} version {run.recipe_version}"), ("Began", run.started_utc)]
    rows += [("Ended", run.ended_utc)] if run.ended_utc else []
    rows += [("Checks skipped by force", ", ".join(run.forced))] if run.forced else []
    return f"<h1>Assembly {escape(run.run_id)}</h1>" + table((), rows)


def _verdict(run: RunSummary) -> str:
    word = run.verdict or "no verdict"
    reasons = "".join(f"<li>{escape(str(reason))}</li>" for reason in run.reasons)
    listed = f"<ul>{reasons}</ul>" if reasons else "<p>Nothing speaks against the joint.</p>" if run.verdict else ""
    return f'<h2>Verdict</h2><p class="verdict">{escape(word)} &mdash; {escape(run.state)}</p>{listed}'


def _phases(run: RunSummary) -> str:
    rows = [(phase.name, phase.state, f"{phase.cell_time_s:.1f}") for phase in run.phases]
    return "<h2>Phases</h2>" + table(("phase", "state", "cell time, s"), rows)


def _alignment(value: Value | None) -> str:
    if value is None:
        return ""
    parts = ["<h2>Alignment</h2>", table((), [(label, value[key]) for key, label in NUMBERS.items() if key in value])]
    window = value.get("window")
    if isinstance(window, dict):
        parts.append("<h3>Temperature window</h3>" + table((), sorted(window.items())))
    parts.extend(
        f"<h3>{escape(key)}</h3>" + table((), [tuple(row) for row in matrix if isinstance(row, list)])
        for key, matrix in sorted(value.items())
        if "covariance" in key and isinstance(matrix, list)
    )
    cold, hot = value.get("clearance_mm"), value.get("clearance_hot_mm")
    if isinstance(cold, list):
        warm = hot if isinstance(hot, list) else [None] * len(cold)
        parts.append("<h3>Clearance of each stud, mm</h3>")
        rows = [(index, c, h) for index, (c, h) in enumerate(zip(cold, warm, strict=False))]
        parts.append(table(("joint", "cold", "at docking temperature"), rows))
    return "".join(parts)


def _insertion(rows: tuple[Row, ...], curves: Curves | None) -> str:
    value = typed(rows, "Insertion")
    if value is None:
        return ""
    limit = number_of((((value_of(rows, "run") or {}).get("recipe") or {}).get("jack_up") or {}).get("force_limit_n"))
    numbers = table(
        (), [(key, item) for key, item in value.items() if not isinstance(item, list | dict) and key != "$type"]
    )
    named = [row.value["blob"] for row in rows if row.kind == "blob" and row.value.get("kind") == "force_curve"]
    if not named or curves is None:
        return "<h2>Insertion</h2>" + numbers
    curve = curves(named[-1])
    lines = [Line("net force", curve["z_mm"].tolist(), curve["force_n"].tolist())]
    drawn = chart(lines, x_label="jack, mm", y_label="N", limit=limit if limit == limit else None)
    return "<h2>Insertion</h2>" + numbers + drawn


def _heat(rows: tuple[Row, ...]) -> str:
    proof, seating = typed(rows, "HeatProof"), typed(rows, "Seating")
    parts = ["<h2>Heat and seating</h2>"] if proof or seating else []
    for value in (proof, seating):
        if value:
            plain = [(key, item) for key, item in value.items() if key not in ("samples", "$type")]
            parts.append(table((), plain))
    samples = (proof or {}).get("samples") or []
    if samples:
        times = [number_of(sample["time_s"]) for sample in samples]
        names = [key for key in samples[0] if key.endswith("_c")]
        lines = [Line(name, times, [number_of(sample[name]) for sample in samples]) for name in names]
        parts.append(chart(lines, x_label="cell time, s", y_label="\u00b0C"))
    return "".join(parts)


def _joints(rows: tuple[Row, ...]) -> str:
    joints = [row.value for row in rows if row.kind == "joint"]
    if not joints:
        return ""
    stages = list(dict.fromkeys(str(joint["stage"]) for joint in joints))
    by_index: dict[int, dict[str, Value]] = {}
    for joint in joints:
        by_index.setdefault(int(joint["index"]), {})[str(joint["stage"])] = joint
    cells = [(index, *(_joint(by_index[index].get(stage)) for stage in stages)) for index in sorted(by_index)]
    bad = [joint for joint in joints if joint.get("verdict") != "ok"]
    said = f"<p>{len(joints)} results on {len(by_index)} joints, {len(bad)} of them not ok.</p>"
    return f"<h2>Joints</h2>{said}" + table(("joint", *stages), cells)


def _joint(joint: Value | None) -> str:
    if joint is None:
        return "-"
    torque, angle = number_of(joint.get("torque_nm")), number_of(joint.get("angle_deg"))
    return f"{joint.get('verdict')}, gun {joint.get('gun')}, {torque:.2f} N m, {angle:.1f} deg"


def _devices(head: Value) -> str:
    devices, backends = head.get("devices") or {}, head.get("backends") or {}
    if not devices:
        return ""
    rows = [
        (
            name,
            *(who.get(key) for key in ("vendor", "model", "serial", "firmware")),
            backends.get(name, ""),
            "simulated" if who.get("simulated") else "",
        )
        for name, who in sorted(devices.items())
    ]
    return "<h2>Devices</h2>" + table(("device", "vendor", "model", "serial", "firmware", "backend", ""), rows)


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """An HTML table; numbers to the right, everything escaped."""
    top = "<tr>" + "".join(f"<th>{escape(name)}</th>" for name in head) + "</tr>" if head else ""
    body = "".join("<tr>" + "".join(_cell(item) for item in row) + "</tr>" for row in rows)
    return f"<table>{top}{body}</table>"


def _cell(item: object) -> str:
    if isinstance(item, float):
        return f'<td class="n">{item:.6g}</td>'
    if isinstance(item, int) and not isinstance(item, bool):
        return f'<td class="n">{item}</td>'
    if isinstance(item, list):
        return f"<td>{escape(', '.join(f'{part:.4g}' if isinstance(part, float) else str(part) for part in item))}</td>"
    return f"<td>{escape('' if item is None else str(item))}</td>"
