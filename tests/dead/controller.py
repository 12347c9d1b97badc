"""A controller with everything under way, to be killed: `python -m tests.dead.controller CELL`. Says "ready" first."""

from __future__ import annotations

import asyncio
import itertools
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from hal.cell import Cell, build_cell
from hal.config import load_cell
from hal.fake.wire.gun_memory import TurnProgram
from hal.interfaces import GuardLimits, Gun

RECIPE = Path(__file__).parents[2] / "recipes" / "lpt_shaft_36.toml"
SPEED = {"stage_x": 5.0, "stage_y": 5.0, "shaft_table": 10.0, "gun_table": 60.0}
"""Axes that go to and fro all the time, and how fast."""
WAY = {"stage_x": 10.0, "stage_y": 10.0, "shaft_table": 20.0, "gun_table": 90.0}
JACK_MM = (60.0, 140.0)


async def main(path: Path) -> None:
    """Until it is ended from outside, or until something is refused."""
    cell = build_cell(load_cell(path))
    try:
        await cell.connect()
        await cell.rearm()
        await cell.gun_feed.home()
        await cell.jack.home()
        await cell.camera_park.go("parked")
        await cell.chuck.clamp()
        for name in SPEED:
            await getattr(cell, name).home()
        await cell.jack.move_to(JACK_MM[0], speed=20.0)
        tare_n = float((await cell.guard.window(0.2)).samples_n.mean())
        limits = GuardLimits("under way", tare_n, 500.0, -500.0, 50.0, 10)
        async with asyncio.TaskGroup() as group:
            for name in SPEED:
                group.create_task(_to_and_fro(cell, name))
            group.create_task(_jack(cell, limits))
            group.create_task(_heat(cell))
            group.create_task(_turn(cell.gun_a))
            group.create_task(_turn(cell.gun_b))
            group.create_task(_read(cell))
            print("ready", flush=True)
    finally:
        await cell.close()


async def _to_and_fro(cell: Cell, name: str) -> None:
    for sign in itertools.cycle((1.0, -1.0) if name != "gun_table" else (1.0, 0.0)):
        await getattr(cell, name).move_to(sign * WAY[name], speed=SPEED[name])


async def _jack(cell: Cell, limits: GuardLimits) -> None:
    """Always under the guard."""
    for target in itertools.cycle(reversed(JACK_MM)):
        await cell.guard.arm(limits)
        await cell.jack.move_to(target, speed=20.0)
        await cell.guard.disarm()


async def _heat(cell: Cell) -> None:
    await cell.heater.heat(80.0, ramp_k_per_min=10.0, max_power_w=2000.0)
    await _always(cell.heater.read)


async def _turn(gun: Gun) -> None:
    """The way in which threads are searched; the gun's controller knows it from the recipe."""
    turn = next(one for one in programs_of(load_recipe(RECIPE).tighten) if isinstance(one, TurnProgram))
    numbers = {"speed_rpm": turn.speed_rpm, "torque_limit_nm": turn.torque_limit_nm}
    await _always(lambda: gun.turn(turn.angle_deg, **numbers))


async def _read(cell: Cell) -> None:
    await asyncio.gather(_always(cell.chuck.read), _always(cell.camera_park.read))


async def _always(do: Callable[[], Awaitable[object]]) -> None:
    while True:
        await do()
        await asyncio.sleep(0.2)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
