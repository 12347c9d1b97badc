"""Nuts started by hand: the run suspends itself, a person confirms, and each nut is still looked for."""

from __future__ import annotations

import asyncio
from pathlib import Path

from cellctl.recipe import Recipe
from cellctl.runner import RunRequest, compose
from cellctl.states import Command, State
from hal.clock import run_virtual
from hal.fake.devices.guns import joints_of
from hal.fake.joints.joint import NutState
from tests.journeys.twin_runs import RememberedJobs, assembled, small_recipe, told, twin_cell

JOBS = RememberedJobs()


def by_hand() -> Recipe:
    recipe = small_recipe()
    return recipe.model_copy(update={"tighten": recipe.tighten.model_copy(update={"nut_supply": "hand_started"})})


def test_the_joint_becomes_good() -> None:
    outcome = assembled(by_hand(), twin_cell(), jobs=JOBS)
    assert outcome.verdict == "accepted", told(outcome)
    assert outcome.truth.good


def test_no_gun_moves_before_a_person_has_confirmed_and_a_nut_that_is_not_there_is_missed(tmp_path: Path) -> None:
    async def main() -> tuple[State, str]:
        made = compose(RunRequest(by_hand(), twin_cell(), 1, tmp_path, keep="none", jobs=JOBS))
        await made.connect()
        controller = made.controller
        controller.request(Command.RESET)
        await controller.until(State.IDLE)
        controller.start(made.assembly)
        await controller.until(State.SUSPENDED)
        assert "start 8 nuts by hand" in controller.snapshot().why
        await asyncio.sleep(600.0)
        assert controller.state is State.SUSPENDED
        assert (await made.twin.cell.gun_feed.read()).position == 0.0
        joints = joints_of(made.twin.behind.plant)
        joints.socket_has_nut("a")  # by now the operator has been there
        joints.nuts.state[3] = NutState()  # and has forgotten one
        controller.request(Command.UNSUSPEND)
        state = await controller.until(State.HELD, State.COMPLETE, State.ABORTED)
        why = controller.snapshot().why
        await controller.shutdown()
        await made.twin.cell.close()
        return state, why

    state, why = run_virtual(main())
    assert state is State.HELD, why
    assert "joint 3" in why
