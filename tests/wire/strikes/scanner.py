"""Strikes on a scanner, by file drop and behind GenTL, in any moment of a capture: its own frame, or the true error."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass
from random import Random
from typing import Any

from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.fake.faults import Fault, FaultBook
from tests.contract import wire_gentl, wire_scanner
from tests.contract.backends import plant_of, quickened
from tests.wire.strikes import Lift, Strike, entered, nothing

LATE = Fault("scanner", "late", phase="late", value=2.5, duration_s=2.0)
OLD = Fault("scanner", "old_frame", phase="old", duration_s=4.0)
GONE = Fault("scanner", "gone", phase="gone", duration_s=3.0)


@dataclass(frozen=True, slots=True)
class At:
    """Where a fault strikes; `side` is the simulator."""

    side: Any
    scanner: Any
    book: FaultBook
    draw: Random


@dataclass(frozen=True, slots=True)
class Fate:
    """`strike` before a capture (`first`) or amid it. `errors` may be told, and one must be where it `must`."""

    strike: Callable[[At], Awaitable[Lift]]
    errors: tuple[type[DeviceError], ...]
    must: bool = True
    first: bool = True


def goes(kind: str, value: object) -> Callable[[At], Awaitable[Lift]]:
    """Something of the simulator's wire, for one capture."""

    async def strike(at: At) -> Lift:
        plain = getattr(at.side.wire, kind)
        setattr(at.side.wire, kind, value)

        async def end() -> None:
            setattr(at.side.wire, kind, plain)

        return end

    return strike


async def unmounted(at: At) -> Lift:
    """The folder is gone for a while, as when the network is."""
    at.side.unmount()

    async def back() -> None:
        await asyncio.sleep(at.draw.uniform(0.0, 3.0))
        at.side.mount()

    return back


async def server_gone(at: At) -> Lift:
    """The camera is gone for a while."""
    await at.side.server.close()

    async def back() -> None:
        await asyncio.sleep(at.draw.uniform(0.0, 3.0))
        await at.side.server.start()

    return back


async def killed(at: At) -> Lift:
    """The producer's process dies, and its adapter with it."""
    os.kill(at.scanner._process.pid, at.draw.choice((signal.SIGKILL, signal.SIGSEGV)))
    return nothing


FILE_DROP = {
    "cable pulled and plugged back": Fate(unmounted, (NotConnected,), first=False),
    "adapter gone": Fate(entered(GONE), (NotConnected,), first=False),
    "half frames": Fate(goes("half_file", 1), (DeviceFault,)),
    "half an answer": Fate(goes("half_answer", 1), (DeviceFault,)),
    "no cloud": Fate(goes("no_cloud", 1), (DeviceFault,)),
    "late reply": Fate(entered(LATE), (DeviceTimeout,), must=False),
    "no answer": Fate(goes("mute", 1), (DeviceTimeout,)),
    "duplicate": Fate(entered(OLD), (), must=False),
    "wrong id": Fate(goes("wrong_request", 1), (DeviceFault,)),
    "wrong view": Fate(goes("view", "shaft"), (ImplausibleReading,)),
    "wrong unit": Fate(goes("unit", "m"), (ImplausibleReading,)),
}
GENTL = {
    "cable pulled and plugged back": Fate(server_gone, (NotConnected,), first=False),
    "adapter gone": Fate(killed, (NotConnected,), first=False),
    "half frames": Fate(goes("half", 1), (DeviceFault,)),
    "late reply": Fate(entered(LATE), (DeviceTimeout,), must=False),
    "no answer": Fate(goes("silent", 1), (DeviceTimeout,)),
    "duplicate": Fate(entered(OLD), (), must=False),
    "hung up": Fate(goes("hang_up", 1), (NotConnected,)),
    "wrong unit": Fate(goes("unit", "Meter"), (ImplausibleReading,)),
}


@dataclass(frozen=True, slots=True)
class Way:
    """How a scanner stands on the wire, and what of its cell file."""

    wired: Callable[..., Any]
    numbers: Mapping[str, float]
    speed: float
    fates: Mapping[str, Fate]


WAYS = {
    "file drop": Way(wire_scanner.wired, {"frame_s": 3.0, "reply_s": 1.0}, 50.0, FILE_DROP),
    "gentl": Way(wire_gentl.wired, {"frame_s": 3.0, "reply_s": 4.0}, 10.0, GENTL),
}


@contextlib.asynccontextmanager
async def standing(way: Way, draw: Random) -> AsyncIterator[At]:
    """A scanner, connected, its arm in view rotor."""
    plant, book = plant_of("ideal"), FaultBook([LATE, OLD, GONE])
    plant.camera = "rotor"
    async with way.wired("scanner", plant, book, **way.numbers) as (side, scanner):
        await scanner.connect()
        yield At(side, scanner, book, draw)


def struck(by: str, fault: str) -> Strike:
    """One capture that goes wrong among good ones."""
    way = WAYS[by]
    fate = way.fates[fault]

    def strike(seed: int) -> None:
        draw = Random(f"{by} {fault} {seed}")

        async def main() -> None:
            async with standing(way, draw) as at:
                await _struck(at, fate)

        quickened(main(), way.speed)

    return strike


async def _struck(at: At, fate: Fate) -> None:
    number, loop = 0, asyncio.get_running_loop()
    for _ in range(at.draw.randint(0, 2)):
        number = await _good(at, number)
    lift = await fate.strike(at) if fate.first else nothing
    asked_s, capture = loop.time(), asyncio.create_task(at.scanner.capture("rotor"))
    if not fate.first:
        await asyncio.sleep(at.draw.uniform(0.0, 0.5))
        lift = await fate.strike(at)
    try:
        frame = await capture
    except DeviceError as error:
        assert isinstance(error, fate.errors), f"{error!r} in the place of {fate.errors}"
    else:
        young = frame.frame_id > number and frame.time_s >= asked_s
        old = frame.frame_id <= number and frame.time_s < asked_s
        assert young or old, f"frame {frame.frame_id} of {frame.time_s:.2f} s, asked for at {asked_s:.2f} s"
        assert not fate.must, "nobody noticed"
        number = max(number, frame.frame_id)
    await lift()
    await asyncio.sleep(at.draw.uniform(0.0, 5.0))
    for _ in range(2):
        number = await _good(at, number)


async def _good(at: At, number: int) -> int:
    """A frame of its own, newer than `number`; its number. A scanner that still works on what was given up says so."""
    for _ in range(20):
        with contextlib.suppress(NotConnected, DeviceRefused):
            await at.scanner.rearm()
            asked_s = asyncio.get_running_loop().time()
            frame = await at.scanner.capture("rotor")
            break
        await asyncio.sleep(0.2)
    else:
        raise AssertionError("no frame, however often it is asked for")
    assert frame.points_mm.shape == (4, 6, 3)
    assert frame.frame_id > number, f"frame {frame.frame_id} again, {number} was seen"
    assert frame.time_s >= asked_s, "a frame from before it was asked for"
    return int(frame.frame_id)


DROP = {fault: struck("file drop", fault) for fault in FILE_DROP}
CAMERA = {fault: struck("gentl", fault) for fault in GENTL}
