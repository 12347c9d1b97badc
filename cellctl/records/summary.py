"""What a run's journal says, in short: header, phases, results, verdict. Pure functions of the rows.

Rows that are read (all others are left alone):

=====================  =================================================================================
``run``                `RunHeader`, the first row
``phase_NAME``         a step's result; the phase is complete with the result named in `LAST_RESULT`
``alignment``          each computed alignment; the last one counts
``joint``              one joint in one stage
``verdict``            verdict and reasons
``ended``              `RunEnded`, the last row
=====================  =================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from cellctl.records.canonical import plain_of
from cellctl.records.chain import GENESIS, Row

Value = Mapping[str, Any]

LAST_RESULT: Mapping[str, str] = MappingProxyType(
    {"scan": "Scans", "align": "Aligned", "jack_up": "Insertion", "heat": "Seating", "tighten": "Closure"}
)
"""The phases in their order, each with the type of the result that completes it."""

NON_FINITE = ("NaN", "Infinity", "-Infinity")

ALIGNMENT = (
    "theta_deg", "x_mm", "y_mm", "tilt_deg", "gap_mm", "sigma_theta_deg", "sigma_xy_mm", "p_insert",
    "predicted_peak_force_n", "clearance_mm",
)  # fmt: skip
INSERTION = ("inserted", "peak_total_n", "peak_bolt_n", "force_basis")
JOINT = ("index", "gun", "stage", "torque_nm", "angle_deg", "verdict")


@dataclass(frozen=True, slots=True)
class RunHeader:
    """What was ordered, of what, on what. Written as kind ``run`` before anything else.

    `recipe` is the whole recipe as data, so that the verdict can be computed again from the record alone. `forced`
    names the physics checks that were skipped. `devices` maps each device to its identity,
    `backends` to the kind in the cell file by which it was reached.
    """

    run_id: str
    job_order_id: str
    recipe: object
    recipe_hash: str
    cell: str
    calibration_id: str
    calibration_hash: str
    rotor_serial: str
    shaft_serial: str
    software: str
    seed: int | None = None
    level: str | None = None
    forced: tuple[str, ...] = ()
    devices: Mapping[str, object] = field(default_factory=dict)
    backends: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RunEnded:
    """How the run ended: `state` is Complete, Held, Stopped or Aborted. Written as kind ``ended``, last."""

    state: str
    verdict: str | None
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class PhaseSummary:
    """One phase: Idle, Running, Complete, or the state that the run ended in while it ran."""

    name: str
    state: str
    cell_time_s: float


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run in short. `state` is Running until the run has ended; results are None before they exist."""

    run_id: str
    job_order_id: str
    recipe: str
    recipe_version: int
    rotor_serial: str
    shaft_serial: str
    state: str
    verdict: str | None
    reasons: tuple[str, ...]
    forced: tuple[str, ...]
    seed: int | None
    started_utc: str
    ended_utc: str | None
    cell_time_s: float
    rows: int
    journal_hash: str
    phases: tuple[PhaseSummary, ...]
    alignment: dict[str, Any] | None
    insertion: dict[str, Any] | None
    heat: dict[str, Any] | None
    joints: tuple[dict[str, Any], ...]


def summarise(rows: tuple[Row, ...]) -> RunSummary:
    """The summary of a run from all its rows, finished or not."""
    head = value_of(rows, "run") or {}
    ended = value_of(rows, "ended")
    said = ended if ended and ended.get("verdict") else (value_of(rows, "verdict") or {})
    recipe = (head.get("recipe") or {}).get("recipe") or {}
    first, last = (rows[0], rows[-1]) if rows else (None, None)
    at_s = continued_s(rows)
    return RunSummary(
        run_id=str(head.get("run_id", "")),
        job_order_id=str(head.get("job_order_id", "")),
        recipe=str(recipe.get("id", "")),
        recipe_version=int(recipe.get("version", 0)),
        rotor_serial=str(head.get("rotor_serial", "")),
        shaft_serial=str(head.get("shaft_serial", "")),
        state=str(ended["state"]) if ended else "Running",
        verdict=said.get("verdict"),
        reasons=tuple((ended or {}).get("reasons") or said.get("reasons") or ()),
        forced=tuple(head.get("forced") or ()),
        seed=head.get("seed"),
        started_utc=first.utc if first else "",
        ended_utc=last.utc if last and ended else None,
        cell_time_s=at_s[-1] - at_s[0] if at_s else 0.0,
        rows=len(rows),
        journal_hash=last.hash if last else GENESIS,
        phases=phases(rows),
        alignment=_some(value_of(rows, "alignment"), ALIGNMENT),
        insertion=_some(typed(rows, "Insertion"), INSERTION),
        heat=heat(rows),
        joints=tuple(_some(row.value, JOINT) or {} for row in rows if row.kind == "joint"),
    )


def phases(rows: tuple[Row, ...]) -> tuple[PhaseSummary, ...]:
    """All phases with their states and times, from where the one before was complete."""
    ended = value_of(rows, "ended")
    state = str(ended["state"]) if ended else "Running"
    at_s = continued_s(rows)
    found = []
    since = at_s[0] if at_s else 0.0
    running = True
    for name, result in LAST_RESULT.items():
        done = [at for at, row in zip(at_s, rows, strict=True) if row.kind == f"phase_{name}" and _type(row) == result]
        if done:
            found.append(PhaseSummary(name, "Complete", done[-1] - since))
            since = done[-1]
        elif running and rows:
            found.append(PhaseSummary(name, state, at_s[-1] - since))
            running = False
        else:
            found.append(PhaseSummary(name, "Idle", 0.0))
    return tuple(found)


def continued_s(rows: tuple[Row, ...]) -> tuple[float, ...]:
    """Cell time of each row on the clock of the first, s; never falls.

    Where the clock steps back, another process writes on with a clock of its own: what lay between the two is not
    known in cell time and counts nothing.
    """
    found = []
    behind = 0.0
    for number, row in enumerate(rows):
        if number:
            behind += max(0.0, rows[number - 1].time_s - row.time_s)
        found.append(row.time_s + behind)
    return tuple(found)


def heat(rows: tuple[Row, ...]) -> dict[str, Any] | None:
    """What heating and seating came to; None before either."""
    proof, seating = typed(rows, "HeatProof"), typed(rows, "Seating")
    if proof is None and seating is None:
        return None
    return {
        "reached_c": (proof or {}).get("reached_c"),
        "spread_k": (proof or {}).get("spread_k"),
        "seated": bool((seating or {}).get("seated", False)),
    }


def value_of(rows: tuple[Row, ...], kind: str) -> Value | None:
    """Payload of the last row of that kind; None where there is none or it is not an object."""
    for row in reversed(rows):
        if row.kind == kind:
            value = row.value
            return value if isinstance(value, dict) else None
    return None


def typed(rows: tuple[Row, ...], name: str) -> Value | None:
    """Payload of the last phase result of the type `name`; None where there is none."""
    for row in reversed(rows):
        if row.kind.startswith("phase_") and _type(row) == name:
            value: Value = row.value
            return value
    return None


def as_plain(summary: RunSummary) -> dict[str, Any]:
    """The summary in terms of JSON."""
    plain: dict[str, Any] = plain_of(summary)
    return plain


def from_plain(plain: dict[str, Any]) -> RunSummary:
    """The summary that `as_plain` gave. Raises TypeError where it is of another shape."""
    phases_of = tuple(PhaseSummary(**phase) for phase in plain.get("phases", ()))
    tuples = {key: tuple(plain.get(key) or ()) for key in ("reasons", "forced", "joints")}
    return RunSummary(**{**plain, **tuples, "phases": phases_of})


def _type(row: Row) -> str | None:
    value = row.value
    return value.get("$type") if isinstance(value, dict) else None


def _some(value: Value | None, keys: tuple[str, ...]) -> dict[str, Any] | None:
    return None if value is None else {key: _number(value.get(key)) for key in keys}


def _number(item: Any) -> Any:
    """What is no finite number is no number to a reader of the summary."""
    return None if item in NON_FINITE else item
