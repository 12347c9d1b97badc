"""What each device of a cell reads just now: values by name, the unit in the name. Nothing moves for it."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from types import MappingProxyType

from hal.cell import Cell
from hal.entries import AXIS_UNITS
from hal.interfaces import ForceBlock, Quality, Reading
from hal.permits import safety_refusal

Value = float | int | str | bool | None
FORCE_S = 0.2
"""A force is the mean over this."""
UNITS: Mapping[str, str] = MappingProxyType(
    {"mm": "mm", "deg": "deg", "n": "N", "c": "°C", "w": "W", "bar": "bar", "mm_s": "mm/s", "deg_s": "deg/s"}
)


class Live:
    """`values` by name, None where the device has none; `wrong` says what it calls wrong itself, or is empty."""

    def __init__(self, values: Mapping[str, Value], wrong: str = "") -> None:
        self.wrong = wrong
        numberless = [name for name, value in values.items() if isinstance(value, float) and not math.isfinite(value)]
        self.values = {**values, **dict.fromkeys(numberless)}


async def axis(cell: Cell, name: str) -> Live:
    """Encoder and flags of a drive."""
    state, unit = await getattr(cell, name).read(), AXIS_UNITS[name]
    numbers: dict[str, Value] = {f"position_{unit}": state.position, f"velocity_{unit}_s": state.velocity}
    return Live({**numbers, "homed": state.homed, "enabled": state.enabled, "brake_closed": state.brake_closed})


async def jack_force(cell: Cell, name: str) -> Live:
    """The jack's sensor is read by the force guard alone."""
    return _force(await cell.guard.window(FORCE_S))


async def force(cell: Cell, name: str) -> Live:
    """Mean and spread of a force."""
    sensor = getattr(cell, name)
    return _force(await sensor.block(max(2, round(FORCE_S * sensor.rate_hz))))


def _force(block: ForceBlock) -> Live:
    low, high = float(block.samples_n.min()), float(block.samples_n.max())
    frozen = "the signal stands still" if low == high else ""
    return Live({"force_n": float(block.samples_n.mean()), "spread_n": high - low}, frozen)


async def temperature(cell: Cell, name: str) -> Live:
    """A thermometer."""
    return _reading(await getattr(cell, name).read(), "temperature_c")


async def gap(cell: Cell, name: str) -> Live:
    """A gap probe."""
    return _reading(await getattr(cell, name).read(), "gap_mm")


def _reading(reading: Reading, name: str) -> Live:
    wrong = "" if reading.quality is Quality.GOOD else f"the reading is {reading.quality}"
    return Live({name: reading.value}, wrong)


async def heater(cell: Cell, name: str) -> Live:
    """Set-point, power and watchdog of the heater controller."""
    state = await cell.heater.read()
    numbers: dict[str, Value] = {"setpoint_c": state.setpoint_c, "power_w": state.power_w}
    flags = {"on": state.on, "watchdog_armed": state.watchdog_armed}
    return Live({**numbers, **flags}, f"alarm: {state.alarm}" if state.alarm else "")


async def chuck(cell: Cell, name: str) -> Live:
    """Both feedbacks and the pressure."""
    state = await cell.chuck.read()
    wrong = "" if state.clamped_1 == state.clamped_2 else "the two feedbacks disagree"
    feedbacks = {"clamped_1": state.clamped_1, "clamped_2": state.clamped_2}
    return Live({**feedbacks, "pressure_bar": state.pressure_bar}, wrong)


async def camera_park(cell: Cell, name: str) -> Live:
    """Where the camera's arm is."""
    place = (await cell.camera_park.read()).position
    return Live({"place": place}, "" if place else "at none of its places, or at two")


async def nut_feeder(cell: Cell, name: str) -> Live:
    """Nuts in the magazine."""
    return Live({"nuts": await cell.nut_feeder.count()})


async def tool_enable(cell: Cell, name: str) -> Live:
    """Whether the guns may turn. Until the cell is re-armed they may not, and nothing is wrong."""
    return Live({"enabled": (await cell.tool_enable.read()).enabled})


async def safety(cell: Cell, name: str) -> Live:
    """The mirror of the hard-wired circuit; None is unknown."""
    state = await cell.safety.read()
    inputs = ("estop_released", "guards_closed", "sto_released", "bench_locked", "bench_moved")
    return Live({name: getattr(state, name) for name in inputs}, safety_refusal(state) or "")


LIVE: Mapping[str, Callable[[Cell, str], Awaitable[Live]]] = MappingProxyType(
    dict.fromkeys(AXIS_UNITS, axis)
    | dict.fromkeys(("gun_force_a", "gun_force_b"), force)
    | dict.fromkeys(("spigot_tc_1", "spigot_tc_2", "pyrometer", "rotor_tc"), temperature)
    | dict.fromkeys(("gap_probe_1", "gap_probe_2", "gap_probe_3"), gap)
    | {
        "jack_force": jack_force,
        "heater": heater,
        "chuck": chuck,
        "camera_park": camera_park,
        "nut_feeder": nut_feeder,
        "tool_enable": tool_enable,
        "safety": safety,
    }
)
"""Devices that measure; the others say no more than whether they are at rest."""


def spoken(values: Mapping[str, Value]) -> str:
    """Values as a person reads them."""
    return ", ".join(_spoken(name, value) for name, value in values.items())


def _spoken(name: str, value: Value) -> str:
    unit = next((one for one in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{one}")), "")
    word = name.removesuffix(f"_{unit}") if unit else name
    if value is None:
        return f"{word} unknown"
    return f"{word} {_number(value)} {UNITS[unit]}" if unit else f"{word} {_number(value)}"


def _number(value: Value) -> str:
    match value:
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value + 0.0:.3f}" if abs(value) < 100.0 else f"{value:.1f}"
        case _:
            return str(value)
