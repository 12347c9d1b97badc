"""SIGSTOP and kill -9 of controller and guard, real processes against the wire simulators, at random moments.

The simulators and the plant behind them live in this process, so that what really moves is seen and not asked for.
Each device has its own limit, which follows from its watchdog; what is stopped is also woken again, and must then leave
everything as it stands.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import socket
import sys
import tempfile
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import MappingProxyType
from typing import Literal

from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.twin import twin_of
from hal.config import CellConfig, load_cell
from hal.entries import AXIS_UNITS
from hal.fake.devices.heating import thermal_of
from hal.fake.heat.control import HeaterControl
from hal.fake.heat.state import TICK_S
from hal.fake.plant import Plant
from hal.fake.wire.modbus_io import StrokePart
from hal.fake.wire.stand import Stand, standing
from hal.jobs import InlineJobs
from hal.priority import real_time

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / "recipes" / "lpt_shaft_36.toml"
CELL = ROOT / "deploy" / "cell.wire.toml"
Victim = Literal["controller", "guard"]
READY_S = 60.0
LOOK_S = 0.002
"""Between two looks at the plant."""
DESK_S = 0.05
"""What a busy desk may add: the simulators' own loop is no drive."""
DROP_MM = 0.05
REAL_TIME = 10
NO_PORTS: Mapping[int, int] = MappingProxyType({})


@dataclass(slots=True)
class Seen:
    """When each axis stood for good, after the signal; how far the jack sank; when heat, outputs and guns went."""

    rest_s: dict[str, float] = field(default_factory=dict)
    drop_mm: float = 0.0
    heater_s: float = 0.0
    outputs_s: float = 0.0
    guns_s: float = 0.0
    moved_again: str = ""


def moment(number: int) -> tuple[str, str]:
    """A word for the tally, and what is wrong, or empty."""
    victim: Victim = "controller" if number % 2 else "guard"
    signal_ = signal.SIGKILL if number // 2 % 2 else signal.SIGSTOP
    return f"{victim} {signal_.name}", asyncio.run(_moment(Random(number), victim, signal_))


async def _moment(draw: Random, victim: Victim, signal_: signal.Signals) -> str:
    with tempfile.TemporaryDirectory(prefix="dead-", dir="/tmp") as folder:
        config = cell_in(Path(folder))
        recipe = load_recipe(RECIPE)
        now = asyncio.get_running_loop().time()
        twin = twin_of(recipe, config, InlineJobs(), seed=draw.randrange(1000), now=now)
        programs = programs_of(recipe.tighten)
        async with (
            standing(config, twin.plant, twin.faults, twin.render, programs) as stand,
            _running(Path(folder), "hal.guard", "--cell", str(config.path)) as guard,
            _running(Path(folder), "tests.dead.controller", str(config.path)) as controller,
        ):
            real_time(REAL_TIME)
            assert controller.stdout is not None
            async with asyncio.timeout(READY_S):
                said = await controller.stdout.readline()
            if said != b"ready\n":
                return f"the controller was not ready: {_last_line(Path(folder))}"
            await asyncio.sleep(draw.uniform(0.2, 2.0))
            if controller.returncode is not None or guard.returncode is not None:
                return f"ended by itself: {_last_line(Path(folder))}"
            dead = controller if victim == "controller" else guard
            dead.send_signal(signal_)
            seen = await _watched(config, twin.plant, stand, victim)
            if signal_ is signal.SIGSTOP:
                dead.send_signal(signal.SIGCONT)
                await _woken(twin.plant, seen)
        return "; ".join(_wrong(config, seen, victim))


def cell_in(folder: Path, ports: Mapping[int, int] = NO_PORTS) -> CellConfig:
    """The wire cell as a file in `folder`, at free ports but for those in `ports`, its guard a service there."""
    text = CELL.read_text(encoding="utf-8")
    with ExitStack() as stack:
        for port in (4401, 4545, 4546, 5021, 5022):
            free = stack.enter_context(socket.socket())
            free.bind(("127.0.0.1", 0))
            other = ports.get(port, free.getsockname()[1])
            text = text.replace(f':{port}"', f':{other}"').replace(f"port = {port}\n", f"port = {other}\n")
    text = text.replace('file = "calibration', f'file = "{ROOT}/deploy/calibration')
    text = text.replace('process = "child" ', 'process = "service" ').replace("../data/wire/", "./")
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return load_cell(path)


@contextlib.asynccontextmanager
async def _running(folder: Path, module: str, *arguments: str) -> AsyncIterator[Process]:
    with (folder / "said").open("ab") as said:
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", module, *arguments, cwd=ROOT, stdout=PIPE, stderr=said
        )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.wait()


def _last_line(folder: Path) -> str:
    """What was said last, with the errors of the one that ended."""
    lines = (folder / "said").read_text(encoding="utf-8", errors="replace").splitlines()
    errors = [line.strip(" |") for line in lines if "hal.errors" in line]
    return (errors or lines or ["nothing"])[-1]


async def _watched(config: CellConfig, plant: Plant, stand: Stand, victim: Victim) -> Seen:
    """Until the last limit has passed."""
    loop, seen = asyncio.get_running_loop(), Seen()
    begun_s = loop.time()
    lasts_s = 1.5 + (_heater_s(config) if victim == "controller" else 0.5)
    couplers = _couplers(config, stand)
    lowest: float | None = None
    while (after_s := loop.time() - begun_s) < lasts_s:
        now = loop.time()
        plant.advance(now)
        for name in AXIS_UNITS:
            if plant.motion[name].moving(now):
                seen.rest_s[name] = after_s
        jack = plant.motion["jack"]
        if not jack.moving(now):
            at_mm = jack.position(now)
            lowest = at_mm if lowest is None else lowest
            seen.drop_mm = max(seen.drop_mm, lowest - at_mm)
        control = thermal_of(plant).source
        if isinstance(control, HeaterControl) and control.on:
            seen.heater_s = after_s
        if any(part.words[part.out.at] for part in couplers):
            seen.outputs_s = after_s
        if plant.tools_enabled or any(gun.turning for gun in stand.guns.values()):
            seen.guns_s = after_s
        await asyncio.sleep(LOOK_S)
    return seen


def _couplers(config: CellConfig, stand: Stand) -> list[StrokePart]:
    """What is moved by outputs."""
    parts = []
    for name in ("chuck", "camera_park", "nut_feeder"):
        entry = config.entries[name]
        for server in stand.modbus:
            with contextlib.suppress(KeyError):
                if isinstance(part := server.part(entry.unit, entry.base), StrokePart):
                    parts.append(part)
    return parts


async def _woken(plant: Plant, seen: Seen) -> None:
    """Whoever was stopped goes on; nothing may move again."""
    loop = asyncio.get_running_loop()
    until_s = loop.time() + 1.5
    while loop.time() < until_s:
        moving = [name for name in AXIS_UNITS if plant.motion[name].moving(loop.time())]
        seen.moved_again = seen.moved_again or ", ".join(moving)
        await asyncio.sleep(LOOK_S)


def _wrong(config: CellConfig, seen: Seen, victim: Victim) -> list[str]:
    """Each device against its own limit."""
    wrong = []
    for name, rest_s in seen.rest_s.items():
        entry = config.entries[name]
        # the trip while armed; a controller that dies just between two moves costs the drives their heartbeat
        silent_s = entry.consumer_s + (0.0 if victim == "guard" else config.guard.quiet_ms * 1e-3)
        ramp_s = entry.max_speed / (entry.quick_stop_factor * entry.max_acceleration)
        if rest_s > (limit_s := silent_s + ramp_s + DESK_S):
            wrong.append(f"{name} stands after {rest_s:.3f} s (limit {limit_s:.3f} s)")
    if seen.drop_mm > DROP_MM:
        wrong.append(f"the jack sank by {seen.drop_mm:.3f} mm (limit {DROP_MM:g} mm)")
    if victim == "controller" and seen.heater_s > (limit_s := _heater_s(config) + 2.0 * TICK_S):
        wrong.append(f"the heater is on for {seen.heater_s:.2f} s (limit {limit_s:g} s)")
    if victim == "controller" and seen.outputs_s > (limit_s := config.devices.chuck.watchdog_s + 0.5):
        wrong.append(f"outputs are set for {seen.outputs_s:.2f} s (limit {limit_s:g} s)")
    enable = config.devices.tool_enable
    guard_s = config.guard.quiet_ms * 1e-3 + config.consumer_s  # a guard that lives is quicker than the watchdog
    if seen.guns_s > (limit_s := (enable.watchdog_s if victim == "guard" else guard_s) + DESK_S):
        wrong.append(f"the guns may turn for {seen.guns_s:.2f} s (limit {limit_s:.2f} s)")
    if seen.moved_again:
        wrong.append(f"{seen.moved_again} moved again when the {victim} went on")
    return wrong


def _heater_s(config: CellConfig) -> float:
    return float(config.devices.heater.watchdog_s)
