"""Bringing every device to its safe state at once, and proving it by reading back. Safe is never assumed."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from dataclasses import dataclass

from hal.errors import CellError
from hal.interfaces import Device, SafeState
from hal.latch import Latch

HALT_SHARE = 0.5
"""Of the deadline: by then a halt must be acknowledged."""
AGAIN_SHARE = 0.7
"""Likewise for the second halt of a device with a command still on its way."""
READ_SHARE = 0.9
"""Likewise for the read-back."""
LOOK_S = 0.01
"""Between two read-backs of a device that is not safe yet."""


@dataclass(frozen=True, slots=True)
class SafeReport:
    """What every device said of its safe state, by name, and how long the stop took (cell seconds)."""

    devices: tuple[tuple[str, SafeState], ...]
    took_s: float

    @property
    def safe(self) -> bool:
        """Whether every device is proven safe."""
        return all(state.safe for _, state in self.devices)

    @property
    def unsafe(self) -> dict[str, str]:
        """Name of each device that is not proven safe, with the reason."""
        return {name: state.detail for name, state in self.devices if not state.safe}


async def make_all_safe(devices: Iterable[Device], latch: Latch, reason: str, deadline_s: float) -> SafeReport:
    """Close the latch, halt all `devices` at once, end what was on its way to them, read their safe states back.

    Never raises and never takes longer than `deadline_s`; a device that does not answer is reported as not safe.
    """
    loop = asyncio.get_running_loop()
    start = loop.time()
    latch.close("safe stop", reason)
    tasks = {
        device.name: loop.create_task(_one(device, latch, start, deadline_s), name=f"{device.name} safe stop")
        for device in devices
    }
    if tasks:
        await asyncio.wait(tasks.values(), timeout=deadline_s)
    return SafeReport(tuple((name, _said(task)) for name, task in tasks.items()), loop.time() - start)


def _said(task: asyncio.Task[SafeState]) -> SafeState:
    if task.done() and not task.cancelled() and task.exception() is None:
        return task.result()
    task.cancel()
    return SafeState(False, "its driver does not come back")


async def _one(device: Device, latch: Latch, start: float, deadline_s: float) -> SafeState:
    trouble = await _halt(device, start + HALT_SHARE * deadline_s)
    await asyncio.sleep(0)  # a halted command may return by itself
    if latch.end(device.name):
        trouble = await _halt(device, start + AGAIN_SHARE * deadline_s)
    state = await _read_back(device, start + READ_SHARE * deadline_s)
    if trouble and not state.safe:
        return SafeState(False, f"{state.detail}; halt: {trouble}")
    return state


async def _halt(device: Device, until: float) -> str:
    """What went wrong, empty where the halt was acknowledged."""
    try:
        async with asyncio.timeout_at(until):
            await device.halt()
    except TimeoutError:
        return "not acknowledged"
    except Exception as error:  # one driver's bug must not keep the others from their read-back
        return str(error)
    return ""


async def _read_back(device: Device, until: float) -> SafeState:
    """The device's own word; asked again while it is on its way to its safe state."""
    state = SafeState(False, "no answer")
    try:
        async with asyncio.timeout_at(until):
            while True:
                state = await device.safe()
                if state.safe:
                    return state
                await asyncio.sleep(LOOK_S)
    except TimeoutError:
        return state
    except CellError as error:
        return SafeState(False, error.reason)
    except Exception as error:  # as above
        return SafeState(False, f"its driver failed: {error!r}")
