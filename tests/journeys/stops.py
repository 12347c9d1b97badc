"""One whole cell, stopped at a random instant by a random command, a device hanging in some: what must hold then."""

from __future__ import annotations

import asyncio
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

from cellctl.recipe import Recipe
from cellctl.records.verify import verify
from cellctl.runner import Composed, RunRequest, compose
from cellctl.safety_watch import watch_safety
from cellctl.states import Command, State
from hal.clock import run_virtual
from hal.config import CellConfig
from hal.entries import Devices
from hal.fake.fault_file import Fault
from hal.interfaces import Device
from tests.journeys.twin_runs import RememberedJobs, small_recipe, twin_cell

LENGTH_S = 450.0
"""About how long the brisk joint takes from its start to its end."""
HANGING = 0.3
"""Share of the stops in which a device hangs from a moment before."""
UNWOUND_S = 60.0
"""By then whatever was asked is done."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What happens when (cell seconds from the start of the run)."""

    at_s: float
    pauses: tuple[tuple[float, Command], ...]
    final: Command
    hung: str | None

    def faults(self) -> tuple[Fault, ...]:
        """The hanging device: it begins shortly before the stop."""
        return () if self.hung is None else (Fault(self.hung, "hung", at_s=max(self.at_s - 0.3, 0.0)),)


@cache
def brisk_recipe() -> Recipe:
    """The same phases in half the time, with four joints: what counts here is where a stop strikes, not how well."""
    recipe = small_recipe(4)
    jack_up = recipe.jack_up.model_copy(update={"contact_speed_mm_s": 0.5, "force_limit_n": 60.0})
    heat = recipe.heat.model_copy(update={"ramp_k_per_min": 40.0, "soak_s": 10.0, "loop_break_s": 30.0})
    return recipe.model_copy(update={"jack_up": jack_up, "heat": heat})


@cache
def brisk_cell() -> CellConfig:
    """The twin's cell with longer blocks of force samples."""
    config = twin_cell()
    return config.model_copy(update={"guard": config.guard.model_copy(update={"contact_block": 40})})


def plan_of(draw: Random, devices: tuple[str, ...]) -> Plan:
    """A random stop: at any instant, often after a hold or a suspension."""
    at_s = draw.uniform(0.0, LENGTH_S)
    pauses: list[tuple[float, Command]] = []
    if draw.random() < 0.5:
        pause, resume = draw.choice([(Command.HOLD, Command.UNHOLD), (Command.SUSPEND, Command.UNSUSPEND)])
        pauses.append((draw.uniform(0.0, at_s), pause))
        if draw.random() < 0.7:
            pauses.append((draw.uniform(pauses[0][0], at_s), resume))
    hung = draw.choice(devices) if draw.random() < HANGING else None
    return Plan(at_s, tuple(pauses), draw.choice([Command.STOP, Command.ABORT]), hung)


def stopped(draw: Random, jobs: RememberedJobs) -> str:
    """Run one plan. Raises AssertionError where a rule of stopping is broken; returns what happened, one line."""
    config = brisk_cell()
    plan = plan_of(draw, tuple(Devices.model_fields))
    with tempfile.TemporaryDirectory() as folder:
        request = RunRequest(brisk_recipe(), config, 1, Path(folder), plan.faults(), keep="none", jobs=jobs)
        return run_virtual(_drive(request, plan, config.cell.safe_deadline_s))


async def _drive(request: RunRequest, plan: Plan, deadline_s: float) -> str:
    made = compose(request)
    await made.connect()
    controller = made.controller
    controller.request(Command.RESET)
    await controller.until(State.IDLE)
    watch = asyncio.create_task(watch_safety(controller, made.twin.cell.until_unsafe))
    controller.start(made.assembly)
    start_s = asyncio.get_running_loop().time()
    for when_s, command in plan.pauses:
        await _until(start_s + when_s)
        if command in controller.allowed():
            controller.request(command)
    await _until(start_s + plan.at_s)
    phase, before = controller.snapshot().phase, controller.state
    if plan.final in controller.allowed():
        controller.request(plan.final)
    asked_s = asyncio.get_running_loop().time()
    await _require_safe_within(made, deadline_s, plan.hung)
    await asyncio.sleep(UNWOUND_S)
    watch.cancel()
    await asyncio.wait({watch})
    await controller.shutdown()
    await made.twin.cell.close()
    assert controller.state in (State.STOPPED, State.ABORTED, State.HELD, State.COMPLETE), controller.state
    if plan.hung is not None and before not in (State.HELD, State.ABORTED, State.STOPPED, State.COMPLETE):
        assert controller.state is State.ABORTED, f"{controller.state} with a device that hangs"
        assert plan.hung in dict(controller.snapshot().unsafe)
    await _require_nothing_left()
    record = made.store.record_path(made.assembly.run_id)
    assert record is not None, "no record was sealed"
    found = verify(record)
    assert found.ok, found.reasons
    return f"{phase or 'start'} {before} {plan.final} {plan.hung or ''} {asked_s - start_s:.1f} s -> {controller.state}"


async def _until(when_s: float) -> None:
    await asyncio.sleep(max(0.0, when_s - asyncio.get_running_loop().time()))


async def _require_safe_within(made: Composed, deadline_s: float, hung: str | None) -> None:
    """Every device but the hanging one reads back safe, one deadline after the command, and stays so."""
    await asyncio.sleep(deadline_s + 1e-6)
    for device in made.twin.cell.devices():
        if device.name != hung:
            await _require_safe(device)


async def _require_safe(device: Device) -> None:
    state = await device.safe()
    assert state.safe, f"{device.name}: {state.detail}"


async def _require_nothing_left() -> None:
    for _ in range(3):
        await asyncio.sleep(0)
    left = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    assert not left, f"tasks left behind: {left}"
