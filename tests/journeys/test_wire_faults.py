"""The judge of runs over the wire notices what must never be; two of the runs themselves at night."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cellctl.records.canonical import canonical
from cellctl.records.chain import GENESIS, Row, link
from cellctl.twin import twin_of
from hal.fake.devices.guns import joints_of
from hal.interfaces import TighteningProgram
from hal.jobs import InlineJobs
from tests.journeys.stops import brisk_recipe
from tests.journeys.twin_runs import twin_cell
from tests.journeys.wire_faults import CASES, run_of
from tests.journeys.wire_judge import Begun, Ended, witness, wrong

PROGRAM = TighteningProgram("snug", 10.0, 9.0, 11.0, 0.0, 720.0, 2.0, 60.0, 10.0)
ONE = Begun("gun_a", "k1", "snug", 0, 1)
BLAMES = ("jack",)


def rows(*told: tuple[str, dict[str, object]]) -> tuple[Row, ...]:
    return tuple(link(at, 0.0, "", kind, canonical(value), GENESIS) for at, (kind, value) in enumerate(told, 1))


INTENT = ("intent", {"key": "k1", "device": "gun_a", "command": "tighten"})
K2 = ("intent", {"key": "k2", "device": "gun_a", "command": "tighten"})
JOINT = ("joint", {"index": 0, "stage": "snug", "verdict": "ok"})
GOOD = Ended("Complete", "accepted", (), (), (ONE,), rows(INTENT, JOINT), ())
HELD = replace(GOOD, state="Held", verdict="held", reasons=("jack: no heartbeat",), after="Idle")


def test_a_run_that_goes_on_or_is_held_for_the_true_reason_is_right() -> None:
    assert wrong(GOOD, BLAMES, goes_on=True) == []
    assert wrong(HELD, BLAMES) == []


@pytest.mark.parametrize(
    ("ended", "found"),
    [
        (replace(GOOD, begun=(ONE, replace(ONE, key="k2"))), "joint 0 was tightened 2 times in stage snug"),
        (replace(GOOD, begun=(ONE, replace(ONE, joint=None))), "gun_a ran k1 2 times"),
        (replace(GOOD, rows=rows(JOINT)), "ran k1, of which the record says nothing"),
        (replace(GOOD, rows=rows(INTENT, JOINT, JOINT)), "joint 0 is told 2 times in stage snug, and was tightened 1"),
        (replace(GOOD, begun=()), "joint 0 is told 1 times in stage snug, and was tightened 0"),
        (replace(GOOD, untrue=("yielded: 0",)), "accepted, but in truth yielded: 0"),
        (replace(GOOD, state="Held"), "accepted in state Held"),
        (replace(GOOD, struck=False), "ended before the fault"),
        (replace(GOOD, record=("row 3 is not what was written",)), "row 3"),
        (replace(HELD, reasons=("gun_a: alarm",)), "does not say what is true"),
        (replace(HELD, reasons=()), "does not say what is true"),
        (replace(HELD, state="Complete", verdict="rejected"), "neither held nor accepted"),
        (replace(HELD, reasons=("jack: KeyError: 3",)), "nobody foresaw"),
        (replace(HELD, after="Stopped: jack"), "does not come back"),
    ],
)
def test_what_must_never_be_is_noticed(ended: Ended, found: str) -> None:
    assert any(found in text for text in wrong(ended, BLAMES))


def test_a_run_that_should_go_on_must_not_be_held() -> None:
    assert any("does not go on" in text for text in wrong(HELD, BLAMES, goes_on=True))


def test_other_parts_have_the_same_joints() -> None:
    both = replace(GOOD, begun=(ONE, replace(ONE, key="k2", parts=2)), rows=rows(INTENT, K2, JOINT))
    assert wrong(both, BLAMES) == []


def test_the_plant_is_the_witness_of_what_guns_begin() -> None:
    plant = twin_of(brisk_recipe(), twin_cell(), InlineJobs(), seed=1).plant
    joints = joints_of(plant)
    begun = witness(joints)
    joints.begin("a", "k1#1", PROGRAM, 0.0)
    assert begun == [Begun("gun_a", "k1", "snug", None, 1)]  # the socket is far from any nut


def test_cases_are_known_by_their_names() -> None:
    names = [case.name for case in CASES]
    assert len(set(names)) == len(names)


@pytest.mark.nightly  # 10 s of CPU each
@pytest.mark.parametrize("name", ["scanner: half a cloud", "CAN: emergency"])
def test_a_fault_on_the_wire_ends_held_and_says_why(name: str) -> None:
    number = [case.name for case in CASES].index(name)
    assert run_of(number) == (f"{name}: Held", "")
