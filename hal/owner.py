"""Whether somebody else controls the drives. Their bus tells: a controller at work sends its heartbeat. Two that come
at the same moment do not hear each other yet: on one machine a lock on the cell file keeps them apart."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from pathlib import Path

from hal.codec.cia301 import HEARTBEAT
from hal.codec.lawicel import CanFrame
from hal.config import CellConfig
from hal.entries import CanAxisEntry
from hal.errors import DeviceRefused, NotConnected

MARGIN_S = 0.1


@contextlib.contextmanager
def sole_user(cell_file: Path) -> Iterator[None]:
    """Hold the cell file while devices are in hand. Raises DeviceRefused where another command holds it."""
    with contextlib.ExitStack() as stack:
        try:
            import fcntl

            file = stack.enter_context(cell_file.open("rb"))
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DeviceRefused(f"{cell_file.name}: another command has this cell's devices in hand") from None
        except (ImportError, OSError):
            pass  # no such locks on this system, or no file: the heartbeat must do
        yield


class _Heard:
    """A listener that waits for one frame."""

    def __init__(self) -> None:
        self.event = asyncio.Event()

    def frame(self, frame: CanFrame) -> None:
        self.event.set()

    def down(self, reason: str) -> None:
        """A bus that is lost says nothing of who is on it."""


async def refuse_second_controller(config: CellConfig) -> None:
    """Listen for as long as the drives would wait for their controller. Raises DeviceRefused where one is heard.

    Nothing is sent but what opening the adapter needs. An adapter that cannot be opened is not this question's matter,
    nor is one that a guard of the system's owns: that guard itself takes no second controller.
    """
    periods_s = [entry.heartbeat_s for entry in config.entries.values() if isinstance(entry, CanAxisEntry)]
    if not periods_s or config.can is None or config.guard.process == "service":
        return
    from hal.bus.can import CanBus

    bus = CanBus(config.can.described, node=config.can.node)
    heard = _Heard()
    try:
        await bus.open()
    except NotConnected:
        return
    end = bus.subscribe(HEARTBEAT + config.can.node, heard)
    try:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(2.0 * max(periods_s) + MARGIN_S):
                await heard.event.wait()
    finally:
        end()
        await bus.release()
    if heard.event.is_set():
        where = f"{config.can.channel}: node {config.can.node}"
        raise DeviceRefused(f"{where} is at work (its heartbeat is heard): a bus has one controller, end it first")
