"""Socket engagement: the socket finds the nut by slow feed and slow turn inside a force window, in bounded tries."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.motion import move
from cellctl.steps.together import together
from hal.interfaces import ForceSensor, Gun, TurnResult

Name = Literal["a", "b"]
START_RPM = 30.0
"""Whole turns onto a thread; angles below a turn are searched at the recipe's slow speed."""
LOOK = 5
"""Samples of contact force that make one look."""


async def engage_nuts(run: RunContext) -> tuple[int, int]:
    """Fresh nuts from the magazine onto two studs: contact, reverse turn to find the start, then two turns."""
    if run.recipe.tighten.nut_supply == "hand_started":
        return await engage_sockets(run)
    for name in ("a", "b"):
        await _load(run, name)
    await _feed_until_contact(run)
    recipe = run.recipe.tighten
    torque = recipe.thread_start_torque_nm
    await together(
        _turn(run, "a", -recipe.engage.reverse_deg, torque), _turn(run, "b", -recipe.engage.reverse_deg, torque)
    )
    turns = await together(
        _turn(run, "a", recipe.engage.start_turns_deg, torque), _turn(run, "b", recipe.engage.start_turns_deg, torque)
    )
    for name, turn in zip("ab", turns, strict=True):
        if turn.angle_deg < recipe.engage.start_turns_deg - 1.0:
            raise RunHeld(
                "thread_not_started",
                f"gun {name} met {turn.peak_torque_nm:.1f} Nm after {turn.angle_deg:.0f} deg (limit {torque} Nm): "
                "the thread has not started cleanly",
            )
    return 1, 1


async def engage_sockets(run: RunContext) -> tuple[int, int]:
    """Empty sockets over two nuts that are there. Returns how many tries each gun took."""
    engage = run.recipe.tighten.engage
    await move(run, "gun_feed", engage.nut_from_mm)
    await move(run, "gun_feed", engage.edge_mm, speed=engage.feed_speed_mm_s)
    tries = {"a": 1, "b": 1}
    for _ in range(engage.max_tries):
        resting = await _where(run, lambda force: force >= engage.force_low_n)
        if not resting:
            break
        for name in resting:
            await _turn(run, name, engage.turn_step_deg, engage.turn_torque_nm)
            tries[name] += 1
    await move(run, "gun_feed", engage.engaged_mm, speed=engage.feed_speed_mm_s)
    outside = await _where(run, lambda force: not engage.force_low_n <= force <= engage.force_high_n)
    if outside:
        await retract(run)
        raise RunHeld(
            "socket_not_engaged",
            f"gun {' and '.join(outside)}: contact force outside {engage.force_low_n} to {engage.force_high_n} N "
            f"at feed {engage.engaged_mm} mm after {engage.max_tries} tries",
        )
    return tries["a"], tries["b"]


async def retract(run: RunContext) -> None:
    """Both guns back, clear of the joint."""
    await move(run, "gun_feed", 0.0)


async def _load(run: RunContext, name: Name) -> None:
    seen = await run.ledger.act("nut_feeder", "load", {"gun": name}, lambda key: run.devices.nut_feeder.load(name))
    if not seen:
        raise RunHeld("nut_missing", f"no nut is seen in the socket of gun {name}")


async def _feed_until_contact(run: RunContext) -> None:
    engage = run.recipe.tighten.engage
    await move(run, "gun_feed", engage.nut_from_mm)
    for position in np.arange(engage.nut_from_mm, engage.nut_to_mm + engage.feed_step_mm, engage.feed_step_mm):
        await move(run, "gun_feed", float(position), speed=engage.feed_speed_mm_s)
        if await _where(run, lambda force: force > engage.force_high_n):
            break
        if not await _where(run, lambda force: force < engage.force_low_n):
            return
    await retract(run)
    raise RunHeld(
        "nut_no_contact",
        f"contact force not within {engage.force_low_n} to {engage.force_high_n} N on both guns "
        f"up to feed {engage.nut_to_mm} mm",
    )


async def _where(run: RunContext, holds: Callable[[float], bool]) -> list[Name]:
    """The guns whose contact force `holds`; a force that is not finite holds for nobody and is refused."""
    force_a, force_b = await together(_force(run.devices.gun_force_a), _force(run.devices.gun_force_b))
    forces: dict[Name, float] = {"a": force_a, "b": force_b}
    for name, force in forces.items():
        if not np.isfinite(force):
            raise RunHeld("gun_force_implausible", f"the contact force of gun {name} reads {force}")
    return [name for name, force in forces.items() if holds(force)]


async def _force(sensor: ForceSensor) -> float:
    return float(np.mean((await sensor.block(LOOK)).samples_n))


async def _turn(run: RunContext, name: Name, angle_deg: float, torque_nm: float) -> TurnResult:
    gun: Gun = run.devices.gun_a if name == "a" else run.devices.gun_b
    speed = run.recipe.tighten.engage.turn_speed_rpm if abs(angle_deg) < 360.0 else START_RPM
    return await run.ledger.act(
        f"gun_{name}",
        "turn",
        {"angle_deg": angle_deg, "speed_rpm": speed, "torque_limit_nm": torque_nm},
        lambda key: gun.turn(angle_deg, speed_rpm=speed, torque_limit_nm=torque_nm),
    )
