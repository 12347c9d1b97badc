"""The phase's computation is the vision port's, never the loop's own: what comes from there is journalled and gated."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from cellctl.docking import Alignment, AlignSpec, align
from cellctl.kinematics import AxesPosition
from cellctl.ports import RunHeld
from cellctl.steps.align import align_shaft
from cellctl.steps.results import Scans
from cellctl.vision.part import PartMeasurement, Refused
from hal.clock import run_virtual
from tests.docking import parts

ANGLES = parts.recipe().pattern.angles()
HOME = AxesPosition(0.0, 0.0, 0.0, 0.0)
SCANS = Scans(
    parts.measurement("stud", parts.pose(z=parts.HEIGHT, down=True), tuple(-angle for angle in ANGLES)),
    parts.measurement("hole", parts.pose(), ANGLES),
    HOME,
    0.0,
)


class Answering:
    """A vision port that gives what it was made with."""

    def __init__(self, answer: Alignment | Refused) -> None:
        self.answer = answer

    async def align(
        self, rotor: PartMeasurement, shaft: PartMeasurement, measured_at: AxesPosition, spec: AlignSpec
    ) -> Alignment:
        assert (rotor, shaft, measured_at) == (SCANS.rotor, SCANS.shaft, HOME)
        assert (spec.theta_low_deg, spec.theta_high_deg) == (-12.0, 34.0)
        if isinstance(self.answer, Refused):
            raise self.answer
        return self.answer


def held_with(answer: Alignment | Refused) -> tuple[RunHeld, list[object]]:
    """How the phase ends on an alignment that stops it, and what was journalled."""
    noted: list[object] = []

    async def note(kind: str, value: object) -> None:
        noted.append(value)

    run: Any = SimpleNamespace(
        devices=SimpleNamespace(shaft_table=SimpleNamespace(limits=SimpleNamespace(low=-12.0, high=34.0))),
        recipe=parts.recipe(),
        vision=Answering(answer),
        ledger=SimpleNamespace(note=note),
    )
    with pytest.raises(RunHeld) as held:
        run_virtual(align_shaft(run, SCANS))
    return held.value, noted


def test_what_the_vision_port_refuses_holds_the_run() -> None:
    held, noted = held_with(Refused("features_missing", "two studs were not found"))
    assert (held.code, held.reason) == ("features_missing", "two studs were not found")
    assert noted == []


def test_what_the_vision_port_gives_is_journalled_and_gated() -> None:
    found = align(SCANS.rotor, SCANS.shaft, parts.calibration(), HOME, AlignSpec(ANGLES, 0.15))
    tilted = replace(found, tilt_deg=9.0)
    held, noted = held_with(tilted)
    assert held.code == "tilt_beyond_gate"
    assert noted == [tilted]
