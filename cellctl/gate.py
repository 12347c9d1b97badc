"""The checkpoint behind the commands hold, suspend and complete: where a run may pause or end."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable


class Gate:
    """`cellctl.ports.Checkpoint`. Asked and released by the controller, passed by the run.

    `on_asked` is called with what the run itself asks of a person, `on_reached` once the holding condition is reached,
    `on_left` once the run is ready to go on.
    """

    def __init__(
        self, *, on_asked: Callable[[str], None], on_reached: Callable[[], None], on_left: Callable[[], None]
    ) -> None:
        self._on_asked = on_asked
        self._on_reached = on_reached
        self._on_left = on_left
        self._open = asyncio.Event()
        self._open.set()
        self._end_asked = False
        self.paused = False
        self.end_reached = asyncio.Event()

    def ask(self) -> None:
        """The next checkpoint pauses the run."""
        self._open.clear()

    def release(self) -> None:
        """Let a paused run go on; from now on it is on its way, even if it is asked again at once."""
        self.paused = False
        self._open.set()

    def ask_end(self) -> None:
        """The next checkpoint is the last: the run stays there until it is cancelled."""
        self._end_asked = True

    async def __call__(
        self,
        retreat: Callable[[], Awaitable[None]] | None = None,
        resume: Callable[[], Awaitable[None]] | None = None,
        *,
        ask: str = "",
    ) -> None:
        """Pause here if that was asked for; see `cellctl.ports.Checkpoint`. A hold during `resume` pauses again."""
        if self._end_asked:
            self.end_reached.set()
            await asyncio.Event().wait()
        if ask:
            self.ask()
            self._on_asked(ask)
        while not self._open.is_set():
            if retreat is not None:
                await retreat()
            self.paused = True
            self._on_reached()
            await self._open.wait()
            if resume is not None:
                await resume()
            if self._open.is_set():
                self._on_left()
