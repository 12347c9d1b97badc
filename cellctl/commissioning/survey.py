"""Every device of a cell, asked who it is and how it is. Nothing moves, nothing is switched."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from cellctl.commissioning.live import LIVE, Live, Value
from hal.addresses import address_of, bus_of
from hal.cell import EXCHANGE_DEADLINE_S, Cell
from hal.config import CellConfig
from hal.errors import CellError
from hal.interfaces import Device, Identity

GOOD = "good"


@dataclass(frozen=True, slots=True)
class Found:
    """One device. With an `error` (and its stable `code`) it has no values; `health` is what the device itself says
    is wrong, or "good"."""

    name: str
    kind: str
    address: str
    identity: Identity | None = None
    health: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    error: str = ""
    code: str = ""


async def survey(cell: Cell, config: CellConfig, names: Iterable[str] | None = None) -> tuple[Found, ...]:
    """All devices, or those of `names`, in the order of the cell file. Devices that share a Modbus line, which answers
    one question at a time, are asked one after the other, all others at once. Never raises for a device."""
    asked = tuple(config.entries if names is None else names)
    lines: dict[str, list[str]] = defaultdict(list)
    for name in asked:
        lines[bus_of(config, name) if config.kinds[name] == "modbus" else name].append(name)

    async def in_turn(line: list[str]) -> list[Found]:
        return [await look(cell, config, name) for name in line]

    found = {one.name: one for line in await asyncio.gather(*map(in_turn, lines.values())) for one in line}
    return tuple(found[name] for name in asked)


async def look(cell: Cell, config: CellConfig, name: str) -> Found:
    """One device, connected where it is not, each exchange within its deadline."""
    device: Device = getattr(cell, name)
    found = Found(name, config.kinds[name], address_of(config, name))
    try:
        async with asyncio.timeout(EXCHANGE_DEADLINE_S):
            found = replace(found, identity=await device.connect())
        async with asyncio.timeout(EXCHANGE_DEADLINE_S):
            state = await device.safe()
            live = await LIVE[name](cell, name) if name in LIVE else Live({"state": state.detail})
    except TimeoutError:
        what = "connect" if found.identity is None else "say how it is"
        return replace(found, error=f"did not {what} within {EXCHANGE_DEADLINE_S:g} s", code="device_timeout")
    except CellError as error:
        return replace(found, error=error.reason, code=error.code)
    except Exception as error:  # one driver's bug must not hide the others
        return replace(found, error=f"its driver failed: {error!r}", code="driver_failed")
    health = live.wrong or (GOOD if state.safe else f"not at rest: {state.detail}")
    return replace(found, health=health, values=live.values)
