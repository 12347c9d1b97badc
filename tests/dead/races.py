"""Trips raced with motion commands under virtual time: the axis' real backend, the guard's sentry, the simulated drive.

What the controller sends takes a random while to reach the guard, in order, and the guard trips at a random instant.
From then on the drive must not be enabled by anything that is still on its way, or sent by tasks that do not know yet.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from random import Random

from hal.bus.ears import Ears, Listener
from hal.bus.hub import CanHub
from hal.clock import run_virtual
from hal.codec.cia301 import RPDO1, heartbeat, pack
from hal.codec.cia402 import CONTROLWORD, ENABLE, LAYOUTS, MODE, QUICK_STOP, START, Mode, State
from hal.codec.lawicel import CanFrame
from hal.errors import CellError
from hal.fake.faults import FaultBook
from hal.fake.wire.can_node import CanNode
from hal.guard.logic import Trip
from hal.guard.sentry import Sentry
from hal.interfaces import AxisState
from hal.real.axes import CanAxis
from tests.contract.backends import plant_of
from tests.contract.wire_axis import FEED, entry_of

NAME, NUMBER, CONTROLLER = "jack", 3, 127
LATEST_S = 0.01
"""On the way from controller to guard."""
WATCHED_S = 0.3
"""After a trip: far longer than anything is on its way."""


class RacedLink:
    """`hal.bus.ears.Link` through a sentry to a hub in the same loop. `enabled` counts what must never be."""

    def __init__(self, hub: CanHub, draw: Random) -> None:
        self._bus, self._detach = hub.attach(self._heard)
        self._draw, self._loop = draw, asyncio.get_running_loop()
        self._ears = Ears()
        self._free_s = 0.0
        self.sentry = Sentry(self._stop, lambda: None, beat_s=0.1, quiet_s=0.5, consumer_s=0.2)
        self.epoch = 0
        self.enabled: list[str] = []
        self.drive_state: Callable[[], State] = lambda: State.NOT_READY
        self._cycle_s = 0.05
        self._cycling = self._loop.call_soon(self._cycle)

    def close(self) -> None:
        """No timer is left."""
        self._cycling.cancel()
        self._detach()

    def _cycle(self) -> None:
        now = self._loop.time()
        self.sentry.beat(now)
        if self.sentry.heartbeat_due(now):
            self._bus(heartbeat(CONTROLLER))
            self.sentry.heartbeat_sent(now)
        self._cycling = self._loop.call_later(self._cycle_s, self._cycle)

    def _stop(self) -> None:
        self._bus(CanFrame(RPDO1 + NUMBER, pack(LAYOUTS[RPDO1], {CONTROLWORD: QUICK_STOP, MODE: 1})))

    def _heard(self, frame: CanFrame) -> None:
        self._ears.heard(frame, self._loop.time())

    def later(self, act: Callable[[], None]) -> None:
        """At the guard after a random while, in order."""
        self._free_s = max(self._free_s + 1e-6, self._loop.time() + self._draw.uniform(0.0, LATEST_S))
        self._loop.call_at(self._free_s, act)

    def send(self, frame: CanFrame) -> None:
        """Without the look at what was told, which a controller's own end would take first."""
        epoch = self.epoch
        self.later(lambda: self._arrived(frame, epoch))

    def _arrived(self, frame: CanFrame, epoch: int) -> None:
        before = self.drive_state()
        if self.sentry.passes(frame, epoch, self._loop.time()):
            self._bus(frame)
        if self.sentry.gate.latched and self.drive_state() is State.OPERATION_ENABLED:
            self.enabled.append(f"{before.name} by {frame.can_id:#x} {frame.data.hex()}")

    async def open(self) -> None:
        """It is."""

    async def release(self) -> None:
        """Nothing to let go."""

    def subscribe(self, can_id: int, listener: Listener) -> Callable[[], None]:
        """See `Ears`."""
        return self._ears.subscribe(can_id, listener)

    def watch(self, can_id: int, within_s: float, lost: Callable[[], None]) -> Callable[[], None]:
        """See `Ears`."""
        return self._ears.watch(can_id, within_s, lost, self._loop.time())

    async def clear(self) -> None:
        """Re-arm: the number of the trip that is known now, after all that was sent before."""
        asked, cleared = self.sentry.gate.epoch, asyncio.Event()

        def act() -> None:
            assert self.sentry.clear(asked, self._loop.time()) == ""
            cleared.set()

        self.later(act)
        await cleared.wait()
        self.epoch = asked


async def _commands(axis: CanAxis, draw: Random) -> None:
    """Whatever enables and moves, without end, by a task that hears of no trip."""
    while True:
        with contextlib.suppress(CellError):
            match draw.randrange(5):
                case 0:
                    await axis.rearm()
                case 1:
                    word = draw.choice((ENABLE, ENABLE | START, 0x3F, 0x07))
                    axis.node.put(RPDO1, {CONTROLWORD: word, MODE: Mode.PROFILE_POSITION})
                case 2:
                    await axis.node.download(CONTROLWORD, draw.choice((ENABLE, ENABLE | START)))
                case _:
                    await axis.move_to(draw.uniform(0.0, 300.0), speed=draw.uniform(1.0, 20.0))
        await asyncio.sleep(draw.uniform(0.0, 0.02))


async def _race(link: RacedLink, axis: CanAxis, node: CanNode, draw: Random) -> str:
    """One trip; what is wrong with what followed, or empty."""
    await link.clear()
    await axis.rearm()
    link.enabled.clear()
    tasks = [asyncio.create_task(_commands(axis, draw)) for _ in range(draw.randint(1, 3))]
    await asyncio.sleep(draw.uniform(0.0, 0.3))
    link.sentry.latch(Trip("raced"))
    await asyncio.sleep(WATCHED_S)
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
    await asyncio.sleep(LATEST_S)
    if link.enabled:
        return f"enabled while latched: {link.enabled[0]}"
    state: AxisState = await axis.read()
    return "it moves" if state.moving else ""


def raced(seed: int, count: int) -> str:
    """`count` trips, one after the other; what was wrong with the first that was not right, or empty."""

    async def main() -> str:
        draw, hub, plant, faults = Random(seed), CanHub(), plant_of("ideal"), FaultBook()
        entry = entry_of(NAME, NUMBER)
        node = CanNode(hub, NUMBER, NAME, plant, faults, scale=entry.counts_per_unit, feed=FEED)
        link = RacedLink(hub, draw)
        link.drive_state = lambda: node.drive.state
        axis = CanAxis(NAME, "mm", entry, link)
        try:
            await axis.connect()
            await link.clear()
            await axis.rearm()
            await axis.home()
            for number in range(count):
                if wrong := await _race(link, axis, node, draw):
                    return f"trip {number}: {wrong}"
            return ""
        finally:
            await axis.close()
            link.close()
            node.close()

    return run_virtual(main())
