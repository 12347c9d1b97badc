"""The latch between commands and metal: while anything holds it closed, nothing that moves or heats may be started.

Who closes it (force guard, safe stop) opens it again, each its own reason only. A command that passed before the latch
closed is known here until it ends, so that whoever stops the cell can end it and stop the device once more.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Literal, TypeVar

from hal.errors import GuardTripped, Interrupted, SafetyError, SafetyOpen

T = TypeVar("T")
Holder = Literal["guard", "safe stop"]


class Latch:
    """One per cell. Not a lock: closing never waits."""

    def __init__(self) -> None:
        self._reasons: dict[Holder, str] = {}
        self._running: dict[asyncio.Task[Any], str] = {}
        self.on_change: Callable[[], None] = lambda: None
        """Told whenever somebody has closed or opened it."""

    @property
    def closed(self) -> bool:
        """Whether commands are refused."""
        return bool(self._reasons)

    def close(self, holder: Holder, reason: str) -> None:
        """Refuse every command from now on; the first reason of a holder stays."""
        self._reasons.setdefault(holder, reason)
        self.on_change()

    def open(self, holder: Holder) -> None:
        """Take this holder's reason away; other reasons stay."""
        self._reasons.pop(holder, None)
        self.on_change()

    def reason(self, holder: Holder) -> str:
        """Why this holder keeps it closed, or nothing."""
        return self._reasons.get(holder, "")

    def refusal(self, device: str) -> SafetyError | None:
        """The error that a command to `device` meets now, or None."""
        if "guard" in self._reasons:
            return GuardTripped(self._reasons["guard"])
        if "safe stop" in self._reasons:
            return SafetyOpen(f"stopped until re-armed: {self._reasons['safe stop']}", device=device)
        return None

    def start(self, device: str, command: Callable[[], Coroutine[Any, Any, T]]) -> asyncio.Task[T]:
        """Start `command` of `device` unless the latch is closed. Raises GuardTripped or SafetyOpen.

        Between the look at the latch and the command's first step nothing else can run that `end` would not find.
        """
        if refused := self.refusal(device):
            raise refused
        task = asyncio.get_running_loop().create_task(command(), name=f"{device} command")
        self._running[task] = device
        task.add_done_callback(self._ended)
        return task

    def result(self, device: str, task: asyncio.Task[T]) -> T:
        """What the finished `task` returned or raised. Raises Interrupted where `end` ended it."""
        if task.cancelled():
            why = self.refusal(device)
            raise Interrupted(f"ended: {why.reason if why else 'its command was withdrawn'}", device=device)
        return task.result()

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._running.pop(task, None)
        if not task.cancelled():
            task.exception()  # marked as seen: whoever abandoned the command does not ask for it

    def end(self, *devices: str) -> set[str]:
        """Cancel commands still running (of `devices`, or all); returns whose they were."""
        ended = set()
        for task, device in list(self._running.items()):
            if not devices or device in devices:
                task.cancel()
                ended.add(device)
        return ended
