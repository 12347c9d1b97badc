"""`python -m hal.guard --cell FILE [--child]`: the guard process of one cell, until SIGTERM, SIGINT or, as a child, the
end of its standard input. Exit 0 after an ordered end, 2 where a file or a setting is wrong."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import fcntl
import logging
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from hal.bus.can import CanBus
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError
from hal.guard.files import lock_beside
from hal.guard.process import GuardProcess
from hal.priority import never_paused, real_time
from hal.systemd import Watchdog, notify

REAL_TIME = 50


def main(argv: Sequence[str] | None = None) -> int:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m hal.guard", description=__doc__)
    parser.add_argument("--cell", type=Path, required=True, help="cell file (TOML)")
    parser.add_argument("--child", action="store_true", help="end when standard input ends")
    args = parser.parse_args(argv)
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    try:
        config = load_cell(args.cell)
        if config.guard.process == "in_loop":
            raise ConfigError("the guard of this cell runs in the controller's loop", place="guard.process")
        with only_one(lock_beside(config.beside(config.guard.socket))):
            asyncio.run(guard(config, child=args.child))
    except (ConfigError, OSError) as error:
        sys.stderr.write(f"guard: {error}\n")
        return 2
    return 0


@contextlib.contextmanager
def only_one(path: Path) -> Iterator[None]:
    """Wait for the guard before this one to end: adapter and sensor have one owner."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


async def guard(config: CellConfig, *, child: bool) -> None:
    """Guard until told to end. Raises OSError."""
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    for one in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(one, ended.set)
    assert config.can is not None, "the cell file was checked"
    # A child speaks to its parent alone: the service manager's ear is lent to the service.
    on_cycle = None if child else Watchdog().feed
    process = GuardProcess(config, CanBus(config.can.described, node=config.can.node), on_cycle)
    await process.start()
    if not child:
        notify("READY=1")
    never_paused()
    real_time(REAL_TIME)
    if child:
        loop.add_reader(sys.stdin.fileno(), _at_the_end, ended)
    try:
        await ended.wait()
    finally:
        await process.close()


def _at_the_end(ended: asyncio.Event) -> None:
    if not os.read(sys.stdin.fileno(), 4096):
        asyncio.get_running_loop().remove_reader(sys.stdin.fileno())
        ended.set()


if __name__ == "__main__":
    sys.exit(main())
