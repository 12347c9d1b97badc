"""Phase heat, second half: close the joint inside the time window. A critical section: it is finished or undone."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from statistics import fmean

from cellctl.ports import RunContext, RunHeld
from cellctl.steps.heat import STALE_S, check_channels, look, mean_c
from cellctl.steps.jack_up import guard_limits, guarded_move
from cellctl.steps.results import Aligned, HeatProof, Insertion, Seating

ENTRY_MM = 0.05
"""The spigot may engage so much earlier than the recipe says: by then the limit of the insertion no longer holds."""
TOUCH_MM = 0.2
"""Above this gap the jack travels at seating speed, below it closes step by step with a look at the force."""
LOOK_S = 0.02


async def seat(run: RunContext, aligned: Aligned, insertion: Insertion, proof: HeatProof | None) -> Seating:
    """Press the faces together with the holding force. Raises RunHeld after withdrawing when it does not close.

    Where the recipe lets the nuts draw the joint in, it may stay open here.
    """
    await run.checkpoint()
    await _require_window(run, proof)
    started = asyncio.get_running_loop().time()
    if proof is not None:
        await run.ledger.act("heater", "off", {}, lambda key: run.devices.heater.off())
    run.progress.report("heat", 0.95, "seating")
    entry_n = await _approach(run, aligned, insertion)
    seating, trip = await _close(run, aligned, insertion, started)
    seating = replace(seating, entry_peak_n=entry_n)
    if seating.seated:
        return seating
    if run.recipe.heat.draw_in and seating.peak_n >= run.recipe.heat.hold_force_n:
        # the nuts close what is left, and the probes prove it then
        await _clear_trip(run)
        return seating
    shown = ", ".join("no value" if math.isinf(gap) else f"{gap:.3f} mm" for gap in seating.gap_mm)
    reason = f"at {seating.peak_n:.0f} N of seating force the gap probes read {shown}{trip and f' ({trip})'}"
    if await _withdrawn(run, insertion):
        raise RunHeld("seating_force", reason)
    raise RunHeld("spigot_gripped", f"{reason}; the spigot grips and the shaft does not come back: re-heat, withdraw")


async def _require_window(run: RunContext, proof: HeatProof | None) -> None:
    if proof is None:
        return
    sample = await look(run)
    check_channels(run.recipe.heat, [sample])
    difference = mean_c(sample) - sample.rotor_c
    if not proof.window_low_k <= difference <= proof.window_high_k:
        raise RunHeld(
            "temperature_window_left",
            f"the difference is {difference:.1f} K, outside {proof.window_low_k:.1f} to {proof.window_high_k:.1f} K",
        )


async def _approach(run: RunContext, aligned: Aligned, insertion: Insertion) -> float:
    """Up to the spigot under the insertion's limit: hot, the studs have less room. Returns the peak, newton."""
    gain = run.calibration.jack_force.gain
    limits = guard_limits(run, "entry", insertion.tare_n, run.guard_plan.insert_trip_n / gain)
    spigot_z = aligned.alignment.target.z_mm - run.recipe.heat.spigot_depth_mm - ENTRY_MM
    state = await guarded_move(run, max(spigot_z, insertion.z_mm), run.recipe.jack_up.contact_speed_mm_s, limits)
    if state.tripped:
        await _withdrawn(run, insertion)
        raise RunHeld("hot_contact", f"before the spigot: {state.reason}; the studs do not keep free while hot")
    return state.peak_n * gain


async def _close(run: RunContext, aligned: Aligned, insertion: Insertion, started: float) -> tuple[Seating, str]:
    """What came of it, and why the guard tripped, empty where it did not."""
    recipe = run.recipe.heat
    gain = run.calibration.jack_force.gain
    limits = guard_limits(run, "seat", insertion.tare_n, recipe.seat_force_limit_n / gain)
    touch = aligned.alignment.target.z_mm
    state = await guarded_move(run, touch - TOUCH_MM, recipe.seat_speed_mm_s, limits)
    peak, force, z = state.peak_n * gain, 0.0, touch - TOUCH_MM
    while not state.tripped and force < recipe.hold_force_n and z < touch + recipe.seat_travel_mm:
        z += recipe.seat_step_mm
        state = await guarded_move(run, z, recipe.seat_speed_mm_s, limits)
        peak = max(peak, state.peak_n * gain)
        block = await run.interlock.window(LOOK_S)
        force = (fmean(block.samples_n) - insertion.tare_n) * gain
    gap = await gaps(run)
    seating = Seating(
        seated=force >= recipe.hold_force_n and max(map(abs, gap)) <= run.recipe.limits.gap_mm,
        z_mm=(await run.devices.jack.read()).position,
        gap_mm=gap,
        hold_n=force,
        peak_n=peak,
        seconds_s=asyncio.get_running_loop().time() - started,
    )
    return seating, state.reason if state.tripped else ""


async def gaps(run: RunContext) -> tuple[float, float, float]:
    """The three gap probes, mm; infinite where a probe gives no value that may be used."""
    values = []
    for name in ("gap_probe_1", "gap_probe_2", "gap_probe_3"):
        reading = await getattr(run.devices, name).read()
        fresh = asyncio.get_running_loop().time() - reading.time_s <= STALE_S
        usable = fresh and reading.quality == "good" and math.isfinite(reading.value)
        values.append(reading.value if usable else math.inf)
    return values[0], values[1], values[2]


async def _withdrawn(run: RunContext, insertion: Insertion) -> bool:
    """Out of the spigot again, under a pulling limit: a gripped spigot is not torn out. Returns whether it came."""
    await _clear_trip(run)
    limits = guard_limits(run, "withdraw", insertion.tare_n, run.recipe.heat.seat_force_limit_n)
    state = await guarded_move(run, insertion.z_mm, run.recipe.heat.seat_speed_mm_s, limits)
    return not state.tripped


async def _clear_trip(run: RunContext) -> None:
    await run.interlock.rearm()
    await run.ledger.act("jack", "rearm", {}, lambda key: run.devices.jack.rearm())
