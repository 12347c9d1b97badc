"""What a run over the wire came to, whatever happened to it on the way, and what must never be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from cellctl.records.chain import Row
from cellctl.records.verify import read_record, verify
from hal.fake.joints.gun_memory import ActiveRun, GunName
from hal.fake.joints.state import Joints
from hal.interfaces import TighteningProgram

READY = "Idle"
AT_REST = ("Held", "Aborted")
VERIFY = "verify"


@dataclass(frozen=True, slots=True)
class Begun:
    """A program that a gun really began: under which key, on which joint of which parts, as the plant has it.

    `joint` is None where the socket met nothing.
    """

    gun: str
    key: str
    stage: str
    joint: int | None
    parts: int


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended, and what is true beside it.

    `after` is the state that the cell came to once the fault was over and an operator had cleared it, with the reason
    where that is not Idle; empty where the run went on to its end. `rows` are those of the record. `struck`: the run
    did not end before the fault.
    """

    state: str
    verdict: str
    reasons: tuple[str, ...]
    untrue: tuple[str, ...]
    begun: tuple[Begun, ...]
    rows: tuple[Row, ...]
    record: tuple[str, ...]
    after: str = ""
    struck: bool = True


def witness(joints: Joints) -> list[Begun]:
    """Everything that guns begin from here on, told by the plant and by nobody else."""
    seen: list[Begun] = []
    parts: list[object] = []
    begin = joints.begin

    def begun(gun: GunName, key: str, program: TighteningProgram, now: float, *, feigned: bool = False) -> ActiveRun:
        active = begin(gun, key, program, now, feigned=feigned)
        if not parts or parts[-1] is not joints.nuts.shaft:
            parts.append(joints.nuts.shaft)
        seen.append(Begun(f"gun_{gun}", key.split("#")[0], program.stage, active.joint, len(parts)))
        return active

    joints.begin = begun  # type: ignore[method-assign]
    return seen


def told_by(record: Path) -> tuple[tuple[Row, ...], tuple[str, ...]]:
    """The rows of a sealed record, and what is wrong with it."""
    found = verify(record)
    return read_record(record)[0], (() if found.ok else found.reasons)


def wrong(ended: Ended, blames: Iterable[str], *, goes_on: bool = False) -> list[str]:
    """Everything about a run that must not be. Where it was held one of `blames` stands in its reasons."""
    return [*_outcome(ended, tuple(blames), goes_on), *twice(ended.begun), *_unwritten(ended), *ended.record]


def twice(begun: Iterable[Begun]) -> Iterator[str]:
    """Each joint of the same parts that was tightened more than once in one stage, and each key that was run twice."""
    times = Counter((one.parts, one.joint, one.stage) for one in begun if one.joint is not None)
    for (_, joint, stage), count in times.items():
        if count > 1:
            yield f"joint {joint} was tightened {count} times in stage {stage}"
    for (gun, key), count in Counter((one.gun, one.key) for one in begun).items():
        if count > 1:
            yield f"{gun} ran {key} {count} times"


def _outcome(ended: Ended, blames: tuple[str, ...], goes_on: bool) -> Iterator[str]:
    told = f"{ended.state}, {ended.verdict}: {'; '.join(ended.reasons)}"
    if not ended.struck:
        yield f"ended before the fault: {told}"
    if ended.verdict == "accepted":
        if ended.untrue:
            yield f"accepted, but in truth {'; '.join(ended.untrue)}"
        if ended.state != "Complete":
            yield f"accepted in state {ended.state}"
        return
    if goes_on:
        yield f"does not go on: {told}"
    if ended.verdict != "held" or ended.state not in AT_REST:
        yield f"neither held nor accepted: {told}"
    if not any(word in reason for reason in ended.reasons for word in blames):
        yield f"does not say what is true ({' or '.join(blames)}): {told}"
    if any("internal_error" in reason or "Error:" in reason for reason in ended.reasons):
        yield f"an error that nobody foresaw: {told}"
    if ended.after != READY:
        yield f"does not come back: {ended.after}"


def _unwritten(ended: Ended) -> Iterator[str]:
    """What was begun without its intent, and what is told as a joint's result and never was."""
    intents = {str(row.value["key"]) for row in _of(ended.rows, "intent") if row.value["command"] == "tighten"}
    for one in ended.begun:
        if one.key not in intents:
            yield f"{one.gun} ran {one.key}, of which the record says nothing"
    met = Counter((one.joint, one.stage) for one in ended.begun)
    told = Counter((int(row.value["index"]), str(row.value["stage"])) for row in _ok_joints(ended.rows))
    for (joint, stage), count in told.items():
        if count > met[joint, stage]:
            yield f"joint {joint} is told {count} times in stage {stage}, and was tightened {met[joint, stage]} times"


def _ok_joints(rows: Iterable[Row]) -> Iterator[Row]:
    return (row for row in _of(rows, "joint") if row.value["verdict"] == "ok")


def _of(rows: Iterable[Row], kind: str) -> Iterator[Row]:
    return (row for row in rows if row.kind == kind)
