"""The contract on metal: devices of a real cell file that the environment names.

    CELLCTL_HARDWARE=/etc/cellctl/cell.toml CELLCTL_HARDWARE_DEVICES=chuck,spigot_tc_1 pytest tests/contract -k hardware

Whatever is named is moved, heated and switched without the motion rules: its surroundings must be clear, and the
hard-wired stop at hand. A case that plants a fault, or looks at what only a twin can show, is skipped with its reason.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Coroutine
from pathlib import Path
from typing import Any, NoReturn

import pytest

from hal.config import CellConfig, load_cell
from hal.fake.faults import Fault
from hal.fake.levels import Level
from hal.guard.heartbeat import BEATS, Heartbeat
from hal.real.build import real_devices
from tests.contract.backends import Backend, Bench, alone

CELL, DEVICES = "CELLCTL_HARDWARE", "CELLCTL_HARDWARE_DEVICES"


class _Unseen:
    def __getattr__(self, name: str) -> NoReturn:
        pytest.skip(f"only a twin can show its {name}")


class HardwareBackend:
    """The named devices of one cell, in real time, each connected by itself."""

    name = "hardware"
    simulated: bool | None = None

    def __init__(self, config: CellConfig, devices: frozenset[str]) -> None:
        guard = config.guard.model_copy(update={"process": "in_loop"})
        self._config = config.model_copy(update={"guard": guard})
        self._devices = devices

    @contextlib.asynccontextmanager
    async def bench(
        self, device: str, *faults: Fault, connect: bool = True, level: Level = "ideal"
    ) -> AsyncIterator[Bench]:
        """One device, closed in the end; its drive hears a controller meanwhile."""
        if device not in self._devices:
            pytest.skip(f"{device} is not in {DEVICES}")
        if faults:
            pytest.skip("no fault is planted in metal")
        real = real_devices(self._config)
        made: Any = real.devices[device]
        beats = Heartbeat(real.can.beat, lambda: True, self._config.consumer_s / BEATS) if real.can else None
        if beats is not None:
            beats.start()
        try:
            if connect:
                await made.connect()
            unseen: Any = _Unseen()
            yield Bench(made, unseen, unseen)
        finally:
            await made.close()
            if beats is not None:
                await beats.close()

    def run(self, main: Coroutine[Any, Any, None]) -> None:
        """In real time; no task may be left."""
        asyncio.run(alone(main))


def hardware() -> tuple[Backend, ...]:
    """What the environment names, or nothing."""
    if CELL not in os.environ:
        return ()
    names = frozenset(filter(None, os.environ.get(DEVICES, "").split(",")))
    config = load_cell(Path(os.environ[CELL]))
    if unknown := names - {name for name, kind in config.kinds.items() if kind != "fake"}:
        raise pytest.UsageError(f"{DEVICES}: {', '.join(sorted(unknown))} is no real device of {os.environ[CELL]}")
    return (HardwareBackend(config, names),)
