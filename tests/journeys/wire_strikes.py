"""What can be done to the wires of a standing cell while a run is on them, and undone after a while."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from random import Random

from hal.bus.hub import BusFault, Kind
from hal.bus.modbus_server import FaultKind, ModbusServer, WireFault
from hal.codec import cia301 as cia
from hal.codec.lawicel import CanFrame
from hal.config import CellConfig
from hal.fake.wire.force import ForceAmplifier
from hal.fake.wire.gun import GunController
from hal.fake.wire.scanner import DropFolder
from hal.fake.wire.stand import Stand

JACK = 3
"""Node of the jack in the wire cell."""
OVER_CURRENT = 0x2310
GENERAL_ERROR = 0x0800_0000
"""SDO abort code."""


@dataclass(frozen=True, slots=True)
class Wires:
    """The simulators of one cell, and what decides at random."""

    stand: Stand
    config: CellConfig
    draw: Random

    def gun(self, name: str = "gun_a") -> GunController:
        """A tightening controller that speaks Open Protocol."""
        controller = self.stand.guns[name]
        assert isinstance(controller, GunController)
        return controller

    def modbus(self, device: str) -> ModbusServer:
        """The server that `device` is behind."""
        entry = self.config.entries[device]
        for one in self.stand.modbus:
            if one.server.framing == "rtu" if entry.port_path else one.server.port == entry.port:
                return one.server
        raise LookupError(device)

    def force(self, name: str) -> ForceAmplifier:
        """The amplifier of a force sensor."""
        return self.stand.forces[name]

    def folder(self) -> DropFolder:
        """The scanner's folder."""
        scanner = self.stand.scanners["scanner"]
        assert isinstance(scanner, DropFolder)
        return scanner


Strike = Callable[[Wires], Awaitable[None]]

# ------------------------------------------------------------ CAN


def can_unplugged(seconds: float) -> Strike:
    """The adapter's cable is out for so long."""

    async def strike(wires: Wires) -> None:
        await wires.stand.hub.unplug()
        await asyncio.sleep(seconds)
        await wires.stand.hub.start()

    return strike


async def can_bus_off(wires: Wires) -> None:
    """The adapter leaves the bus until it is opened anew."""
    wires.stand.hub.bus_off()


def can_frames(kind: Kind, first: int, last: int, count: int, delay_s: float = 0.0) -> Strike:
    """`count` frames whose ids are within `first` and `last` are spoilt."""

    async def strike(wires: Wires) -> None:
        fault = BusFault(kind, lambda frame: first <= frame.can_id <= last, count, delay_s)
        wires.stand.hub.faults.append(fault)

    return strike


async def can_wrong_ids(wires: Wires) -> None:
    """Frames of a node that is not in the cell, and answers to what nobody has asked."""
    send, end = wires.stand.hub.attach(lambda frame: None)
    for _ in range(20):
        send(cia.heartbeat(99, cia.NmtState.OPERATIONAL))
        send(CanFrame(cia.SDO_REPLY + 99, bytes.fromhex("4341600027060000")))
        send(CanFrame(cia.SDO_REPLY + JACK, bytes.fromhex("4308100001000000")))
        await asyncio.sleep(0.1)
    end()


async def can_abort(wires: Wires) -> None:
    """The jack's drive refuses whatever it is asked next by SDO."""
    wires.stand.nodes["jack"].abort_next += [GENERAL_ERROR] * 3


async def can_emergency(wires: Wires) -> None:
    """The jack's drive trips."""
    wires.stand.nodes["jack"].emergency(OVER_CURRENT)


def can_muted(seconds: float) -> Strike:
    """The jack's drive beats no more for so long."""

    async def strike(wires: Wires) -> None:
        node = wires.stand.nodes["jack"]
        node.muted = True
        await asyncio.sleep(seconds)
        node.muted = False

    return strike


# ------------------------------------------------------------ Modbus


def modbus_unplugged(device: str, seconds: float) -> Strike:
    """The cable of the server that `device` is behind is out for so long; a serial adapter comes back as another."""

    async def strike(wires: Wires) -> None:
        server, entry = wires.modbus(device), wires.config.entries[device]
        await server.close()
        if not entry.port_path:
            await asyncio.sleep(seconds)
            await server.start()
            return
        link = wires.config.beside(entry.port_path)
        link.unlink()
        await asyncio.sleep(seconds)
        await server.start_pty()
        link.symlink_to(server.port_path)

    return strike


def modbus_answers(device: str, kind: FaultKind, times: int, value: float = 0.0) -> Strike:
    """So many answers of the server that `device` is behind are spoilt."""

    async def strike(wires: Wires) -> None:
        wires.modbus(device).faults.append(WireFault(kind, value, times))

    return strike


# ------------------------------------------------------------ guns


def gun_unplugged(seconds: float) -> Strike:
    """Nothing passes for so long, and nobody is told."""

    async def strike(wires: Wires) -> None:
        wires.gun().wire.unplugged = True
        await asyncio.sleep(seconds)
        wires.gun().wire.unplugged = False

    return strike


async def gun_dropped(wires: Wires) -> None:
    """The connection ends; what runs goes on."""
    wires.gun().drop()


async def gun_result_lost(wires: Wires) -> None:
    """The next result is told to nobody."""
    wires.gun().wire.lose_results = 1


async def gun_results_twice(wires: Wires) -> None:
    """Every result is told twice from here on."""
    wires.gun().wire.repeat_results = True


async def gun_results_late(wires: Wires) -> None:
    """Every result comes late from here on."""
    wires.gun().wire.late_result_s = 2.0


async def gun_in_pieces(wires: Wires) -> None:
    """Everything comes in pieces of few bytes from here on."""
    wires.gun().wire.piece = wires.draw.randrange(3, 30)


async def gun_strange_results(wires: Wires) -> None:
    """Before each result there is one of somebody else's from here on."""
    wires.gun().wire.strange_identifier = "SOMEBODY-ELSE"


def gun_mute(mid: int) -> Strike:
    """Requests of this kind are carried out and not answered, for a while."""

    async def strike(wires: Wires) -> None:
        wires.gun().wire.mute.add(mid)
        await asyncio.sleep(30.0)
        wires.gun().wire.mute.discard(mid)

    return strike


async def gun_power_cycled(wires: Wires) -> None:
    """Off and on: the program ends where it is."""
    await wires.gun().power_cycle()


# ------------------------------------------------------------ force and scanner


def force_unplugged(name: str, seconds: float) -> Strike:
    """The line's adapter is out for so long."""

    async def strike(wires: Wires) -> None:
        wires.force(name).unplug()
        await asyncio.sleep(seconds)
        wires.force(name).plug()

    return strike


def force_lines(name: str, what: str, count: int) -> Strike:
    """So many sample lines are spoilt: `drop`, `corrupt`, `half` or `repeat`."""

    async def strike(wires: Wires) -> None:
        setattr(wires.force(name).wire, what, count)

    return strike


def scans_unmounted(seconds: float) -> Strike:
    """The scanner's folder is gone for so long."""

    async def strike(wires: Wires) -> None:
        wires.folder().unmount()
        await asyncio.sleep(seconds)
        wires.folder().mount()

    return strike


def scans_spoilt(what: str) -> Strike:
    """One answer is spoilt: `mute`, `half_file`, `half_answer`, `wrong_request` or `no_cloud`."""

    async def strike(wires: Wires) -> None:
        setattr(wires.folder().wire, what, 1)

    return strike
