"""Socket engagement: the socket finds the nut by slow feed and slow turn inside a force window, in bounded tries."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.feed import Name, feed_watched, forces_n
from cellctl.steps.motion import move
from cellctl.steps.order import Pair
from cellctl.steps.together import together
from hal.interfaces import Gun, TurnResult

START_RPM = 30.0
"""Whole turns onto a thread; angles below a turn are searched at the recipe's slow speed."""


async def engage_nuts(run: RunContext, pair: Pair) -> tuple[int, int]:
    """Fresh nuts onto two bare studs, or sockets over two nuts that were started by hand. Returns tries as below."""
    if run.recipe.tighten.nut_supply == "hand_started":
        return await engage_sockets(run, pair, lower_mm=run.recipe.tighten.engage.hand_started_mm)
    for name in ("a", "b"):
        await _load(run, name)
    await _feed_until_contact(run, pair)
    recipe = run.recipe.tighten
    torque = recipe.thread_start_torque_nm
    await together(
        _turn(run, "a", -recipe.engage.reverse_deg, torque), _turn(run, "b", -recipe.engage.reverse_deg, torque)
    )
    turns = await together(
        _turn(run, "a", recipe.engage.start_turns_deg, torque), _turn(run, "b", recipe.engage.start_turns_deg, torque)
    )
    for name, turn in zip(("a", "b"), turns, strict=True):
        if turn.angle_deg < recipe.engage.start_turns_deg - 1.0:
            raise RunHeld(
                "thread_not_started",
                f"{_at(name, pair)} met {turn.peak_torque_nm:.1f} Nm after {turn.angle_deg:.0f} deg "
                f"(limit {torque} Nm): the thread has not started cleanly",
            )
    return 1, 1


async def engage_sockets(run: RunContext, pair: Pair, *, lower_mm: float = 0.0) -> tuple[int, int]:
    """Empty sockets over two nuts that are there, `lower_mm` below their seats. Returns the tries of each gun.

    Raises RunHeld where a nut is not where it must be: the feed never goes on against more than the window's force.
    """
    engage = run.recipe.tighten.engage
    await move(run, "gun_feed", engage.nut_from_mm - lower_mm)
    met = await feed_watched(run, engage.edge_mm - lower_mm, limit_n=engage.force_high_n)
    tries = {"a": 1, "b": 1}
    for _ in range(0 if met else engage.max_tries):
        resting = await _where(run, lambda force: force >= engage.force_low_n)
        if not resting:
            break
        for name in resting:
            await _turn(run, name, engage.turn_step_deg, engage.turn_torque_nm)
            tries[name] += 1
    met = met or await feed_watched(run, engage.engaged_mm - lower_mm, limit_n=engage.force_high_n)
    outside = met or await _where(run, lambda force: not engage.force_low_n <= force <= engage.force_high_n)
    if outside:
        at_mm = (await run.devices.gun_feed.read()).position
        await retract(run)
        raise RunHeld(
            "socket_not_engaged",
            f"{' and '.join(_at(name, pair) for name in outside)}: contact force outside {engage.force_low_n} to "
            f"{engage.force_high_n} N at feed {at_mm:.1f} mm: no nut at its place",
        )
    return tries["a"], tries["b"]


async def retract(run: RunContext) -> None:
    """Both guns back, clear of the joint."""
    await move(run, "gun_feed", 0.0)


async def _load(run: RunContext, name: Name) -> None:
    seen = await run.ledger.act("nut_feeder", "load", {"gun": name}, lambda key: run.devices.nut_feeder.load(name))
    if not seen:
        raise RunHeld("nut_missing", f"no nut is seen in the socket of gun {name}")


async def _feed_until_contact(run: RunContext, pair: Pair) -> None:
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
        f"contact force not within {engage.force_low_n} to {engage.force_high_n} N on both guns at joints "
        f"{pair.a} and {pair.b} up to feed {engage.nut_to_mm} mm",
    )


async def _where(run: RunContext, holds: Callable[[float], bool]) -> tuple[Name, ...]:
    """The guns whose contact force `holds`."""
    return tuple(name for name, force in (await forces_n(run)).items() if holds(force))


def _at(name: str, pair: Pair) -> str:
    return f"gun {name} at joint {pair.a if name == 'a' else pair.b}"


async def _turn(run: RunContext, name: Name, angle_deg: float, torque_nm: float) -> TurnResult:
    gun: Gun = run.devices.gun_a if name == "a" else run.devices.gun_b
    speed = run.recipe.tighten.engage.turn_speed_rpm if abs(angle_deg) < 360.0 else START_RPM
    return await run.ledger.act(
        f"gun_{name}",
        "turn",
        {"angle_deg": angle_deg, "speed_rpm": speed, "torque_limit_nm": torque_nm},
        lambda key: gun.turn(angle_deg, speed_rpm=speed, torque_limit_nm=torque_nm),
    )
