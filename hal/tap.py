"""What passes on one bus of a cell, told record by record: CAN is listened to, streams go through a relay.

On CAN nothing is sent: a second adapter hears what all others say. A TCP connection or a serial port has two ends, so
there a controller must come through the relay, which stands where the tap says.
"""

from __future__ import annotations

import asyncio
import contextlib
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hal.addresses import buses
from hal.capture import Direction, Record
from hal.codec.cia301 import HEARTBEAT, NMT, RPDO1, RPDO2, SDO_REQUEST, SYNC
from hal.codec.lawicel import CanFrame
from hal.config import CellConfig
from hal.errors import ConfigError, NotConnected

Put = Callable[[Record], None]
STANDARD_IDS = 0x800


@dataclass(frozen=True, slots=True)
class Bus:
    """One wire of the cell: its name in words, the kind of its devices' entries, and their names."""

    name: str
    kind: str
    devices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Tap:
    """`config` is the cell file of a controller whose words are told; `where` is where it finds the bus then."""

    config: CellConfig
    where: str


def bus_named(config: CellConfig, word: str) -> Bus:
    """The bus of device `word`, or `can`. Raises ConfigError."""
    for name, devices in buses(config).items():
        kind = config.kinds[devices[0]]
        if word in devices or (word == "can" and kind == "canopen"):
            if kind == "file_drop":
                raise ConfigError("a folder is no bus: what passes lies there as files", place=word)
            return Bus(name, kind, tuple(devices))
    raise ConfigError("on no bus of this cell", place=word, limit=", ".join(sum(buses(config).values(), ["can"])))


@contextlib.asynccontextmanager
async def tapped(config: CellConfig, bus: Bus, put: Put, listen: str = "") -> AsyncIterator[Tap]:
    """`put` is told everything that passes on `bus`; `listen` is the relay's port or the path of its terminal.

    Raises NotConnected where the bus cannot be opened, or the relay not be reached there.
    """
    sink = _Sink(put)
    entry: Any = config.entries[bus.devices[0]]
    try:
        async with AsyncExitStack() as stack:
            if bus.kind == "canopen":
                await _on_can(stack, config, sink)
                yield Tap(config, bus.name)
            elif path := getattr(entry, "port_path", "") or getattr(entry, "path", ""):
                yield await _on_serial(stack, config, bus, str(config.beside(path)), sink, listen)
            else:
                yield await _on_tcp(stack, config, bus, sink, listen)
    except OSError as error:
        raise NotConnected(f"{bus.name}: {error}") from None


async def _on_can(stack: AsyncExitStack, config: CellConfig, sink: _Sink) -> None:
    from hal.bus.can import CanBus

    assert config.can is not None, "the cell file was checked"
    sink.controller = config.can.node
    can = CanBus(config.can.described)
    await can.open()
    stack.push_async_callback(can.release)
    for can_id in range(STANDARD_IDS):
        can.subscribe(can_id, sink)


async def _on_serial(stack: AsyncExitStack, config: CellConfig, bus: Bus, port: str, sink: _Sink, listen: str) -> Tap:
    from hal.bus.relay import SerialRelay

    entry: Any = config.entries[bus.devices[0]]
    path = _terminal(listen or f"{stack.enter_context(tempfile.TemporaryDirectory())}/tap")
    relay = SerialRelay(port, entry.baud, getattr(entry, "parity", "N"), path, sink)
    stack.callback(relay.close)
    relay.start()
    key = "port_path" if hasattr(entry, "port_path") else "path"
    return Tap(_elsewhere(config, bus, {key: str(path)}), str(path))


def _terminal(listen: str) -> Path:
    """Whole, since names in the cell file are relative to it."""
    return Path(listen).absolute()


async def _on_tcp(stack: AsyncExitStack, config: CellConfig, bus: Bus, sink: _Sink, listen: str) -> Tap:
    from hal.bus.relay import TcpRelay

    if listen and not listen.isdecimal():
        raise ConfigError(f"{listen!r} is no port: this bus is reached over TCP", place="--listen")
    entry: Any = config.entries[bus.devices[0]]
    relay = TcpRelay(entry.host, entry.port, sink)
    stack.push_async_callback(relay.close)
    port = await relay.start(int(listen or 0))
    return Tap(_elsewhere(config, bus, {"host": "127.0.0.1", "port": port}), f"127.0.0.1:{port}")


def _elsewhere(config: CellConfig, bus: Bus, changes: dict[str, Any]) -> CellConfig:
    """The cell with the devices of `bus` at another address. A guard process would read the file's own: none here."""
    moved = {name: config.entries[name].model_copy(update=changes) for name in bus.devices}
    devices = config.devices.model_copy(update=moved)
    return config.model_copy(
        update={"devices": devices, "guard": config.guard.model_copy(update={"process": "in_loop"})}
    )


class _Sink:
    """Hears relays and the CAN adapter; stamps what it hears."""

    def __init__(self, put: Put) -> None:
        self.controller = 0
        self._put = put
        self._start_s = asyncio.get_running_loop().time()

    def out(self, link: int, data: bytes) -> None:
        self._put(Record(self._now(), "out", data, link=link))

    def came(self, link: int, data: bytes) -> None:
        self._put(Record(self._now(), "in", data, link=link))

    def event(self, link: int, what: str) -> None:
        self._put(Record(self._now(), link=link, event=what))

    def frame(self, frame: CanFrame) -> None:
        self._put(Record(self._now(), self._way(frame.can_id), frame.data, frame.can_id))

    def down(self, reason: str) -> None:
        if reason != "closed":
            self.event(0, f"lost: {reason}")

    def _way(self, can_id: int) -> Direction:
        """By the predefined connection set of CiA 301: who may say this."""
        mine = can_id in (NMT, SYNC, HEARTBEAT + self.controller)
        return "out" if mine or can_id & 0x780 in (SDO_REQUEST, RPDO1, RPDO2) else "in"

    def _now(self) -> float:
        return asyncio.get_running_loop().time() - self._start_s
