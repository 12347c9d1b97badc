"""A small cell and a small run behind the controller's own protocols, with faults that a test can ask for."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from cellctl.event_log import EventLog
from cellctl.ports import Checkpoint, Progress
from cellctl.session import Outcome, RunEnd
from hal.errors import Interrupted

NAMES = ("jack", "heater", "gun_a", "stage_x")


def virtual_now() -> datetime:
    """2000-01-01 plus the loop's time."""
    return datetime(2000, 1, 1, tzinfo=UTC) + timedelta(seconds=asyncio.get_running_loop().time())


def event_log() -> EventLog:
    """An event log on the loop's clock."""
    return EventLog(virtual_now)


@dataclass
class Report:
    """What make_safe read back."""

    unsafe: dict[str, str]

    @property
    def safe(self) -> bool:
        return not self.unsafe


@dataclass
class DoubleCell:
    """Devices that move for a while when told, stop when halted, and hang where `hung` names them."""

    hung: set[str] = field(default_factory=set)
    halt_s: float = 0.05
    moving: dict[str, float] = field(default_factory=dict)
    commands: int = 0
    rearmed: int = 0
    halted_at: list[float] = field(default_factory=list)
    rearm_error: str = ""
    _ended: asyncio.Event = field(default_factory=asyncio.Event)

    async def move(self, name: str, seconds: float) -> None:
        """Like an axis: raises Interrupted when halted on the way."""
        self.commands += 1
        self.moving[name] = asyncio.get_running_loop().time() + seconds
        ended = self._ended
        try:
            async with asyncio.timeout(seconds):
                await ended.wait()
        except TimeoutError:
            self.moving.pop(name, None)
            return
        raise Interrupted("halted", device=name)

    async def make_safe(self, deadline_s: float) -> Report:
        unsafe: dict[str, str] = {}

        async def halt(name: str) -> None:
            try:
                async with asyncio.timeout(deadline_s):
                    await asyncio.sleep(1e9 if name in self.hung else self.halt_s)
            except TimeoutError:
                unsafe[name] = "no answer to halt"
            else:
                self.moving.pop(name, None)

        self.halted_at.append(asyncio.get_running_loop().time())
        self._ended.set()
        self._ended = asyncio.Event()
        await asyncio.gather(*(halt(name) for name in NAMES))
        return Report(unsafe)

    async def rearm(self) -> None:
        self.rearmed += 1
        if self.rearm_error:
            raise RuntimeError(self.rearm_error)


Body = Callable[["DoubleSession", Checkpoint, Progress], Awaitable[Outcome]]


@dataclass
class DoubleSession:
    """A run whose body a test gives; counts how often it was closed."""

    cell: DoubleCell
    body: Body
    run_id: str = "run-1"
    job_order_id: str = "order-1"
    prepare_s: float = 0.1
    prepare_error: Exception | None = None
    close_s: float = 0.02
    ends: list[RunEnd] = field(default_factory=list)
    open: bool = False
    trail: list[str] = field(default_factory=list)

    async def prepare(self) -> None:
        self.open = True
        await asyncio.sleep(self.prepare_s)
        if self.prepare_error:
            raise self.prepare_error

    async def execute(self, checkpoint: Checkpoint, progress: Progress) -> Outcome:
        return await self.body(self, checkpoint, progress)

    async def close(self, end: RunEnd) -> None:
        self.ends.append(end)
        await asyncio.sleep(self.close_s)
        self.open = False


async def five_phases(session: DoubleSession, checkpoint: Checkpoint, progress: Progress) -> Outcome:
    """Five moves of a second each with a checkpoint after each."""

    async def retreat() -> None:
        session.trail.append("retreat")
        await asyncio.sleep(0.1)

    async def resume() -> None:
        session.trail.append("resume")
        await asyncio.sleep(0.1)

    for index, phase in enumerate(("scan", "align", "jack_up", "heat", "tighten")):
        progress.report(phase, index / 5, f"{phase} runs")
        await session.cell.move(NAMES[index % len(NAMES)], 1.0)
        session.trail.append(phase)
        await checkpoint(retreat, resume)
    return Outcome("accepted")


async def stubborn(session: DoubleSession, checkpoint: Checkpoint, progress: Progress) -> Outcome:
    """A run that swallows its cancellation four times and goes on commanding a device."""
    swallowed = 0
    while swallowed < 4:
        try:
            await session.cell.move("jack", 3.0)
        except Interrupted:
            continue
        except asyncio.CancelledError:
            swallowed += 1
    return Outcome("accepted")
