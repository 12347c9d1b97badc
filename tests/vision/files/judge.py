"""What the command says to a file, and whether that is what it should have said."""

from __future__ import annotations

import contextlib
import io
import json
import signal
import subprocess
import sys
import time
from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cellctl.cli import measure as command
from cellctl.vision.part import Part
from cellctl.vision.pattern import symmetry

Array = NDArray[np.float64]
Expect = Literal["pose", "refused", "unreadable", "no pose", "honest"]
"""The right pose; exit 3; exit 2; either of these; the right pose or none."""
CPU_LIMIT_S = 20
PLACE_MM, ANGLE_DEG = 0.1, 0.05


@dataclass(frozen=True)
class File:
    """A file and what must come of it: poses (4, 4) that are right, places (n, 3) of the drawing where nothing is."""

    what: str
    suffix: str
    data: bytes
    part: Part
    expect: Expect
    truths: tuple[Array, ...] = ()
    closed_mm: Array = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(frozen=True)
class Answer:
    """What came of it: exit code, the document, what was written to standard error, CPU seconds."""

    code: int
    document: dict[str, Any]
    stderr: str
    cpu_s: float

    @property
    def word(self) -> str:
        """ "pose", "unreadable", or the code of the refusal."""
        if self.code == 0:
            return "pose"
        return str(self.document.get("refused", {}).get("code", "unreadable"))


class TookTooLong(BaseException):
    """The command used more CPU than any file may take."""


@contextlib.contextmanager
def _limited(seconds: int) -> Iterator[None]:
    def stop(signal_number: int, frame: FrameType | None) -> None:
        raise TookTooLong(f"more than {seconds} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def ask(path: Path, recipe: Path, side: str, *, own_process: bool = False) -> Answer:
    """`cellctl measure --json`. Raises TookTooLong, and whatever the command lets through."""
    words = ["measure", "--recipe", str(recipe), f"--{side}", str(path), "--json"]
    started = time.process_time()
    if own_process:
        done = subprocess.run([sys.executable, "-m", "cellctl", *words], capture_output=True, text=True, timeout=300)
        return Answer(done.returncode, _one_document(done.stdout), done.stderr, 0.0)
    out, errors = io.StringIO(), io.StringIO()
    parser = ArgumentParser()
    command.add_parser(parser.add_subparsers())
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors), _limited(CPU_LIMIT_S):
        code = command.run(parser.parse_args(words))
    return Answer(code, _one_document(out.getvalue()), errors.getvalue(), time.process_time() - started)


def _one_document(text: str) -> dict[str, Any]:
    document = json.loads(text)
    assert isinstance(document, dict)
    return document


def fault_of(file: File, answer: Answer) -> str:
    """Why the answer is wrong, "" where it is right."""
    if "Traceback" in answer.stderr:
        return f"traceback: {answer.stderr[-300:]}"
    if answer.word == "not_measurable":
        return f"the arithmetic broke down: {answer.document['refused']['reason']}"
    allowed: dict[Expect, tuple[int, ...]] = {
        "pose": (0,), "refused": (3,), "unreadable": (2,), "no pose": (2, 3), "honest": (0, 2, 3),
    }  # fmt: skip
    if answer.code not in allowed[file.expect]:
        return f"{file.expect} expected, exit {answer.code} ({answer.word}): {_why(answer)}"
    return _pose_fault(file, answer) if answer.code == 0 else _silent(answer)


def _why(answer: Answer) -> str:
    refused = answer.document.get("refused") or answer.document.get("error")
    return str(refused["reason"]) if refused else ""


def _silent(answer: Answer) -> str:
    """A refusal has a reason and no pose beside it."""
    if set(answer.document) not in ({"refused"}, {"error"}) or len(_why(answer)) < 5:
        return f"a refusal with {sorted(answer.document)} and reason '{_why(answer)}'"
    return ""


def _pose_fault(file: File, answer: Answer) -> str:
    (side,) = {"rotor", "shaft"} & set(answer.document)
    measured = answer.document[side]
    T = np.array(measured["T_frame_part"])
    place_mm, angle_deg = PLACE_MM, ANGLE_DEG
    if file.expect == "honest":  # a poor cloud may give a poor pose that says so
        sigma = np.sqrt(np.diag(np.array(measured["covariance"])))
        place_mm, angle_deg = max(place_mm, 4.0 * sigma[:3].max()), max(angle_deg, 4.0 * np.degrees(sigma[3:].max()))
    misses = [pose_miss(file.part, truth, T) for truth in file.truths]
    if not any(place < place_mm and lean < angle_deg and abs(turn) < angle_deg for place, lean, turn in misses):
        return f"wrong pose, off by (mm, deg, deg) {[tuple(round(x, 3) for x in miss) for miss in misses]}"
    if abs(np.linalg.det(T[:3, :3]) - 1.0) > 1e-6:
        return "the pose is no rigid motion"
    found = [np.array(item["center_mm"]) for item in measured["features"] if item["found"]]
    invented = [place for place in file.closed_mm if any(np.linalg.norm(centre - place) < 1.5 for centre in found)]
    return f"features at {np.round(invented, 1).tolist()} are not there" if invented else ""


def pose_miss(part: Part, truth: Array, measured: Array) -> tuple[float, float, float]:
    """Place (mm), lean of the normal and turn about it (deg) between two poses, modulo the pattern's symmetry."""
    delta = np.linalg.inv(truth) @ measured
    step = 360.0 / symmetry(part)
    turn = float(np.degrees(np.arctan2(delta[1, 0], delta[0, 0])))
    lean = float(np.degrees(np.arctan2(np.hypot(delta[0, 2], delta[1, 2]), delta[2, 2])))
    return float(np.linalg.norm(delta[:3, 3])), lean, (turn + 0.5 * step) % step - 0.5 * step
