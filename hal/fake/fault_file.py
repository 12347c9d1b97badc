"""Fault files (TOML): what goes wrong, where and when, and how the run must then end.

::

    [[fault]]
    device = "heater"       # a device of the cell file
    phase = "heat"          # begins when this phase is first entered ...
    at_s = 60.0             # ... plus so many seconds; without a phase: seconds of cell time
    kind = "loop_break"     # one of hal.fake.fault_kinds
    value = 1.0             # where the kind takes one
    duration_s = 5.0        # for ever where it is not given

    [expect]
    state = "Held"          # PackML state that the run ends in
    verdict = "held"        # accepted | rejected | held
    reason = "loop"         # part of a reason or code of the outcome
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal.errors import ConfigError
from hal.fake.fault_kinds import DEVICE_KINDS, PHASES

STATES = ("Complete", "Held", "Stopped", "Aborted")
VERDICTS = ("accepted", "rejected", "held")


@dataclass(frozen=True, slots=True)
class Fault:
    """One planted fault: from `at_s` after `phase` was first entered (cell time without a phase), for `duration_s`."""

    device: str
    kind: str
    phase: str | None = None
    at_s: float = 0.0
    value: float | None = None
    duration_s: float = math.inf

    @property
    def number(self) -> float:
        """The value of a kind that needs one."""
        if self.value is None:
            raise ValueError(f"fault {self.device}.{self.kind} carries no value")
        return self.value


@dataclass(frozen=True, slots=True)
class Expect:
    """How a run with these faults must end; `reason` is a part of one of its reasons or codes."""

    state: str
    verdict: str
    reason: str


@dataclass(frozen=True, slots=True)
class FaultFile:
    """The faults of one file in its order, and what is expected of the run where the file says so."""

    faults: tuple[Fault, ...]
    expect: Expect | None


def load_faults(path: Path) -> FaultFile:
    """Fault file from disk. Raises ConfigError."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", place=str(path)) from None
    return parse_faults(text, source=path.name)


def parse_faults(text: str, *, source: str = "faults") -> FaultFile:
    """Fault file from TOML text. Raises ConfigError; with several wrong places its reason names them all."""
    data, wrong = _checked(text, source)
    if len(wrong) == 1:
        raise wrong[0]
    if wrong:
        raise ConfigError(f"{len(wrong)} faults: " + "; ".join(error.reason for error in wrong), place=source)
    expect = data.get("expect")
    return FaultFile(
        faults=tuple(_fault(row) for row in data.get("fault", [])),
        expect=Expect(expect["state"], expect["verdict"], expect.get("reason", "")) if expect else None,
    )


def wrong_places(text: str, *, source: str = "faults") -> tuple[ConfigError, ...]:
    """Everything that is wrong in a fault file, each with its place; empty where it is right."""
    return tuple(_checked(text, source)[1])


def _checked(text: str, source: str) -> tuple[dict[str, Any], list[ConfigError]]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        return {}, [ConfigError(f"not TOML: {error}", place=source)]
    wrong = _unknown(data, ("fault", "expect"), source)
    rows = data.get("fault", [])
    if not isinstance(rows, list):
        wrong.append(ConfigError("must be [[fault]], a list of tables", place=f"{source}.fault"))
        rows = []
    for number, row in enumerate(rows):
        wrong += _row_faults(row, f"{source}.fault.{number}")
    if "expect" in data:
        wrong += _expect_faults(data["expect"], f"{source}.expect")
    return data, wrong


def _fault(row: Mapping[str, Any]) -> Fault:
    value = row.get("value")
    return Fault(
        device=row["device"],
        kind=row["kind"],
        phase=row.get("phase"),
        at_s=float(row.get("at_s", 0.0)),
        value=None if value is None else float(value),
        duration_s=float(row.get("duration_s", math.inf)),
    )


def _unknown(table: Mapping[str, Any], known: tuple[str, ...], place: str) -> list[ConfigError]:
    return [
        ConfigError(f"unknown key {key!r}", place=place, limit=", ".join(known)) for key in table if key not in known
    ]


def _row_faults(row: object, place: str) -> list[ConfigError]:
    if not isinstance(row, dict):
        return [ConfigError("must be a table", place=place)]
    wrong = _unknown(row, ("device", "kind", "phase", "at_s", "value", "duration_s"), place)
    device, kind = row.get("device"), row.get("kind")
    kinds = DEVICE_KINDS.get(device) if isinstance(device, str) else None
    if kinds is None:
        wrong.append(ConfigError(f"unknown device {device!r}", place=f"{place}.device", limit=", ".join(DEVICE_KINDS)))
    elif not isinstance(kind, str) or kind not in kinds:
        limit = ", ".join(kinds)
        wrong.append(ConfigError(f"{device} has no fault of kind {kind!r}", place=f"{place}.kind", limit=limit))
    else:
        wrong += _value_faults(kinds[kind].value, kinds[kind].unit, row, f"{place}.value")
    phase = row.get("phase")
    if phase is not None and phase not in PHASES:
        wrong.append(ConfigError(f"unknown phase {phase!r}", place=f"{place}.phase", limit=", ".join(PHASES)))
    wrong += _number_faults(row, "at_s", place, lambda number: number >= 0, ">= 0")
    wrong += _number_faults(row, "duration_s", place, lambda number: number > 0, "> 0")
    return wrong


def _number_faults(
    row: Mapping[str, Any], key: str, place: str, holds: Callable[[float], bool], limit: str
) -> list[ConfigError]:
    if key not in row or (_is_number(row[key]) and holds(row[key])):
        return []
    return [ConfigError(f"got {row[key]!r}", place=f"{place}.{key}", limit=limit, unit="s")]


def _value_faults(need: str, unit: str, row: Mapping[str, Any], place: str) -> list[ConfigError]:
    value = row.get("value")
    if value is None:
        missing = need in ("needed", "joint")
        return [ConfigError("a value is needed", place=place, limit="a number", unit=unit)] if missing else []
    if need == "none":
        return [ConfigError("this kind takes no value", place=place)]
    if not _is_number(value):
        return [ConfigError(f"got {value!r}", place=place, limit="a finite number", unit=unit)]
    if (need == "joint" or unit == "joint") and not (0 <= value < 120 and float(value).is_integer()):
        return [ConfigError(f"got {value!r}", place=place, limit="0 to 119, whole", unit="joint")]
    return []


def _expect_faults(expect: object, place: str) -> list[ConfigError]:
    if not isinstance(expect, dict):
        return [ConfigError("must be a table", place=place)]
    wrong = _unknown(expect, ("state", "verdict", "reason"), place)
    for key, allowed in (("state", STATES), ("verdict", VERDICTS)):
        if expect.get(key) not in allowed:
            wrong.append(ConfigError(f"got {expect.get(key)!r}", place=f"{place}.{key}", limit=", ".join(allowed)))
    if not isinstance(expect.get("reason", ""), str):
        wrong.append(ConfigError("must be text", place=f"{place}.reason"))
    return wrong


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
