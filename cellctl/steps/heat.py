"""Phase heat, first half: warm the spigot, prove its temperature. The second half is `seat`."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from functools import partial

from cellctl.ports import RunContext, RunHeld
from cellctl.recipe import Heat
from cellctl.steps.results import Aligned, HeatProof, HeatSample
from hal.interfaces import Thermometer

LOOK_S = 2.0
"""Cell seconds between two looks at the temperatures; a fraction of the fastest limit of the phase."""
STALE_S = 5.0
"""A channel renews its value several times in this."""
SETPOINT_K = 0.5
"""A heater controller keeps its set-point in tenths of a kelvin or finer."""
SETTLED_S = 60.0
SETTLED_K = 0.5
"""The difference stands still when it moved less than this in that time."""
STUCK_K = 1e-6
STUCK_LOOKS = 10


@dataclass(frozen=True, slots=True)
class Window:
    """Allowed temperature difference of the heated member against the other one, kelvin."""

    low_k: float
    high_k: float

    def target_k(self, wished_k: float) -> float:
        """The wished difference, but no nearer to an end than a quarter of the window."""
        margin = 0.25 * (self.high_k - self.low_k)
        return min(max(wished_k, self.low_k + margin), self.high_k - margin)


async def heat(run: RunContext, aligned: Aligned) -> HeatProof:
    """Warm to the recipe's difference, soak, prove it by channels that agree. Leaves the heater regulating.

    Raises RunHeld when a channel is implausible, the loop is open or the time is up.
    """
    recipe = run.recipe.heat
    window = window_of(recipe, aligned)
    return await _warm_and_soak(run, recipe, window)


def window_of(recipe: Heat, aligned: Aligned) -> Window:
    """Recipe's own tolerance cut with the two-sided window that fit and clearance leave (design page 1, E28b)."""
    low = max(recipe.difference_k - recipe.difference_tolerance_k, aligned.alignment.window.low_k)
    high = min(recipe.difference_k + recipe.difference_tolerance_k, aligned.alignment.window.high_k)
    if low >= high:
        raise RunHeld(
            "temperature_window_empty",
            f"no temperature opens the fit ({low:.1f} K) and keeps the studs free ({high:.1f} K)",
        )
    return Window(low, high)


async def _warm_and_soak(run: RunContext, recipe: Heat, window: Window) -> HeatProof:
    loop = asyncio.get_running_loop()
    samples: list[HeatSample] = [await look(run)]
    check_channels(recipe, samples)
    target = window.target_k(recipe.difference_k)
    setpoint = samples[0].rotor_c + target
    await _heat_to(run, recipe, setpoint)
    start = set_at = loop.time()
    soaking_since = math.inf
    while True:
        await run.checkpoint(partial(_power_off, run), partial(_heat_to, run, recipe, setpoint))
        await asyncio.sleep(LOOK_S)
        sample = await look(run)
        samples.append(sample)
        check_channels(recipe, samples)
        check_loop(recipe, samples)
        difference = mean_c(sample) - sample.rotor_c
        run.progress.report("heat", min(0.9, max(0.0, difference / target)), f"difference {difference:.1f} K")
        missing = missing_k([seen for seen in samples if seen.time_s >= set_at], target)
        if 0.25 * (window.high_k - window.low_k) < abs(missing) <= recipe.difference_tolerance_k:
            setpoint, set_at = setpoint + missing, loop.time()
            await _heat_to(run, recipe, setpoint)
        if not window.low_k <= difference <= window.high_k:
            soaking_since = math.inf
        elif math.isinf(soaking_since):
            soaking_since = sample.time_s
        if sample.time_s - soaking_since >= recipe.soak_s and spread_k(sample) <= recipe.max_spread_k:
            return proof(samples, window, sample.time_s - soaking_since)
        if loop.time() - start > recipe.timeout_s:
            raise RunHeld(
                "heating_timeout",
                f"after {recipe.timeout_s:.0f} s the difference is {difference:.1f} K "
                f"(wanted {window.low_k:.1f} to {window.high_k:.1f} K), spread {spread_k(sample):.1f} K",
            )


def missing_k(since_set: list[HeatSample], target_k: float) -> float:
    """What the set-point must rise by, once the difference stands still; 0 before.

    The regulator's own sensor sits elsewhere and is off by a kelvin or two; the channels on the spigot decide. What is
    missing beyond the recipe's tolerance is no such offset but a fault, and is left to the checks.
    """
    last = since_set[-1] if since_set else None
    if last is None or last.time_s - since_set[0].time_s < SETTLED_S:
        return 0.0
    recent = [mean_c(seen) - seen.rotor_c for seen in since_set if seen.time_s >= last.time_s - SETTLED_S]
    return 0.0 if max(recent) - min(recent) > SETTLED_K else target_k - sum(recent) / len(recent)


def proof(samples: list[HeatSample], window: Window, soak_s: float) -> HeatProof:
    """The frozen proof from the samples of the phase."""
    last = samples[-1]
    return HeatProof(
        reached_c=mean_c(last),
        difference_k=mean_c(last) - last.rotor_c,
        spread_k=spread_k(last),
        soak_s=soak_s,
        window_low_k=window.low_k,
        window_high_k=window.high_k,
        samples=tuple(samples),
    )


async def look(run: RunContext) -> HeatSample:
    """All temperature channels and the heater's power, read back one after the other."""
    devices = run.devices
    heater = await devices.heater.read()
    if heater.alarm:
        raise RunHeld("heater_alarm", f"the heater reports: {heater.alarm}")
    return HeatSample(
        time_s=asyncio.get_running_loop().time(),
        spigot_1_c=await _temperature_c(devices.spigot_tc_1),
        spigot_2_c=await _temperature_c(devices.spigot_tc_2),
        pyrometer_c=await _temperature_c(devices.pyrometer),
        rotor_c=await _temperature_c(devices.rotor_tc),
        power_w=heater.power_w,
    )


async def _temperature_c(device: Thermometer) -> float:
    """Present temperature; not a number where the channel gives none that may be used, or an old one."""
    reading = await device.read()
    age_s = asyncio.get_running_loop().time() - reading.time_s
    return reading.value if reading.quality == "good" and age_s <= STALE_S else math.nan


def check_channels(recipe: Heat, samples: list[HeatSample]) -> None:
    """Raises RunHeld when a channel is not finite, out of range, stuck, or disagrees with its neighbours."""
    last = samples[-1]
    channels = {name: getattr(last, name) for name in ("spigot_1_c", "spigot_2_c", "pyrometer_c", "rotor_c")}
    for name, value in channels.items():
        if not math.isfinite(value) or not -40.0 <= value <= 400.0:
            raise RunHeld("temperature_implausible", f"{name} reads {value}")
    if max(last.spigot_1_c, last.spigot_2_c) > recipe.max_temperature_c:
        raise RunHeld(
            "over_temperature",
            f"the spigot is at {max(last.spigot_1_c, last.spigot_2_c):.1f} C (limit {recipe.max_temperature_c} C)",
        )
    if spread_k(last) > recipe.channel_gate_k:
        raise RunHeld(
            "temperatures_disagree",
            f"the spigot's two channels differ by {spread_k(last):.1f} K (limit {recipe.channel_gate_k} K)",
        )
    if abs(last.pyrometer_c - mean_c(last)) > recipe.pyrometer_gate_k:
        raise RunHeld(
            "temperatures_disagree",
            f"pyrometer {last.pyrometer_c:.1f} C against {mean_c(last):.1f} C of the contacts "
            f"(limit {recipe.pyrometer_gate_k} K)",
        )
    recent = samples[-STUCK_LOOKS:]
    for name in channels:
        values = [getattr(sample, name) for sample in recent]
        if len(recent) == STUCK_LOOKS and max(values) - min(values) < STUCK_K:
            raise RunHeld("temperature_stuck", f"{name} has not moved at all in {STUCK_LOOKS} looks")


def check_loop(recipe: Heat, samples: list[HeatSample]) -> None:
    """Raises RunHeld when full power brings no rise: sensor fallen off, element broken, fuse blown."""
    last = samples[-1]
    since = [sample for sample in samples if sample.time_s >= last.time_s - recipe.loop_break_s]
    if last.time_s - samples[0].time_s < recipe.loop_break_s:
        return
    powered = min(sample.power_w for sample in since) > 0.5 * recipe.max_power_w
    if powered and mean_c(last) - mean_c(since[0]) < recipe.loop_break_rise_k:
        raise RunHeld(
            "heater_loop_break",
            f"{recipe.loop_break_s:.0f} s of power raised the spigot by less than {recipe.loop_break_rise_k} K",
        )


def mean_c(sample: HeatSample) -> float:
    """Mean of the two contact channels on the spigot."""
    return 0.5 * (sample.spigot_1_c + sample.spigot_2_c)


def spread_k(sample: HeatSample) -> float:
    """Difference between the two contact channels on the spigot."""
    return abs(sample.spigot_1_c - sample.spigot_2_c)


async def _heat_to(run: RunContext, recipe: Heat, setpoint_c: float) -> None:
    arguments = {"setpoint_c": setpoint_c, "ramp_k_per_min": recipe.ramp_k_per_min, "max_power_w": recipe.max_power_w}
    state = await run.ledger.act(
        "heater",
        "heat",
        arguments,
        lambda key: run.devices.heater.heat(
            setpoint_c, ramp_k_per_min=recipe.ramp_k_per_min, max_power_w=recipe.max_power_w
        ),
    )
    if not abs(state.setpoint_c - setpoint_c) <= SETPOINT_K:
        raise RunHeld(
            "setpoint_not_taken",
            f"the heater reads back a set-point of {state.setpoint_c:.1f} C, {setpoint_c:.1f} C was written",
        )
    if not state.watchdog_armed:
        raise RunHeld("watchdog_not_armed", "the heater's off-line watchdog does not read back as armed")


async def _power_off(run: RunContext) -> None:
    await run.ledger.act("heater", "off", {}, lambda key: run.devices.heater.off())
