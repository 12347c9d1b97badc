"""Faults in the scanner's folder: always the true error, never another request's frame."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from hal.bus.folder import Folder
from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.scanner import DropFolder
from hal.real.scanner import FileDropScanner
from tests.contract import wire_scanner
from tests.contract.backends import WireBackend, plant_of, quickened
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase
from tests.wire.frames import each_goes_wrong_once

Case = Callable[[DropFolder, FileDropScanner], Coroutine[Any, Any, None]]
TIMES = 20
SPEED = 50.0


def on_wire(case: Case, *faults: Fault) -> None:
    """Run `case` on a served folder and its backend, connected, under quickened time, the arm in view rotor."""

    async def main() -> None:
        plant = plant_of("ideal")
        plant.camera = "rotor"
        async with wire_scanner.wired("scanner", plant, FaultBook(faults), frame_s=3.0, reply_s=1.0) as (
            server,
            scanner,
        ):
            await scanner.connect()
            await case(server, scanner)

    quickened(main(), SPEED)


@pytest.mark.parametrize(
    ("kind", "value", "error", "reason"),
    [
        ("half_file", 1, DeviceFault, "half a frame"),
        ("half_answer", 1, DeviceFault, "no JSON"),
        ("no_cloud", 1, DeviceFault, "not there"),
        ("wrong_request", 1, DeviceFault, "is answered"),
        ("mute", 1, DeviceTimeout, "no answer to capture"),
        ("unit", "m", ImplausibleReading, "is in 'm', not in mm"),
        ("view", "shaft", ImplausibleReading, "shows 'shaft'"),
    ],
)
def test_each_fault_has_its_error_and_the_next_frame_is_good(
    kind: str, value: object, error: type[DeviceError], reason: str
) -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        await each_goes_wrong_once(scanner, server.wire, kind, value, error, reason, times=TIMES)
        assert server.captures == 2 * TIMES, "nothing is asked twice"

    on_wire(case)


@pytest.mark.parametrize("kind", ["npz", "npy", "ply", "pcd"])
def test_every_kind_of_file_brings_the_same_cloud_and_half_of_it_none(kind: Any) -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        server.kind = kind
        cloud = (await scanner.capture("rotor")).points_mm
        assert cloud.shape == (4, 6, 3)
        server.wire.half_file = 1
        with pytest.raises(DeviceFault, match="half a frame"):
            await scanner.capture("rotor")
        assert (await scanner.capture("rotor")).points_mm.shape == cloud.shape
        await scanner.close()
        assert not [path.name for path in server.folder.iterdir() if path.suffix == f".{kind}"], "what was read is gone"

    on_wire(case)


def test_a_late_answer_is_not_taken_for_the_next() -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        await asyncio.sleep(1.0 - asyncio.get_running_loop().time())
        with pytest.raises(DeviceTimeout):
            await scanner.capture("rotor")
        asked_s = asyncio.get_running_loop().time()
        await asyncio.sleep(2.0)
        frame = await scanner.capture("rotor")
        assert frame.time_s > asked_s
        assert (frame.frame_id, server.captures) == (2, 2)

    on_wire(case, Fault("scanner", "late", value=2.5, at_s=0.9, duration_s=1.0))


def test_a_frame_number_that_has_not_grown_is_an_old_frame() -> None:
    async def case(_: DropFolder, scanner: FileDropScanner) -> None:
        good = await scanner.capture("rotor")
        await asyncio.sleep(20.0)
        old = await scanner.capture("rotor")
        assert (old.frame_id, old.time_s) == (good.frame_id, pytest.approx(good.time_s, abs=0.2))
        assert old.time_s <= good.time_s

    on_wire(case, Fault("scanner", "old_frame", at_s=10.0))


def test_the_folder_goes_away_and_comes_back() -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        for _ in range(TIMES):
            capture = asyncio.create_task(scanner.capture("rotor"))
            await asyncio.sleep(0.3)
            server.unmount()
            with pytest.raises(NotConnected):
                await capture
            for command in (scanner.halt, scanner.safe, scanner.rearm, partial(scanner.capture, "rotor")):
                with pytest.raises(NotConnected):
                    await command()
            await asyncio.sleep(2.0)
            server.mount()
            assert (await scanner.capture("rotor")).points_mm.size

    on_wire(case)


def test_a_command_that_nobody_waits_for_is_withdrawn() -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        await asyncio.sleep(2.0)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.5):
                await scanner.capture("rotor")
        await asyncio.sleep(6.0)
        assert not [path.name for path in server.folder.iterdir() if "request" in path.name]
        assert server.captures == 0

    on_wire(case, Fault("scanner", "hung", at_s=2.0, duration_s=5.0))


def test_what_an_earlier_controller_left_is_neither_read_nor_kept() -> None:
    async def case(server: DropFolder, scanner: FileDropScanner) -> None:
        await scanner.close()
        for name in ("00000900.answer.json", "00000900.npz", "00000901.request.json", "notes.txt"):
            (server.folder / name).write_text("{}", encoding="ascii")
        await scanner.connect()
        await scanner.capture("rotor")
        await scanner.close()
        left = {path.name for path in server.folder.iterdir()}
        assert "notes.txt" in left, "what is not of its own kind stays"
        assert not [name for name in left if name.startswith("000009")]

    on_wire(case)


def test_closing_ends_a_capture_and_the_thread() -> None:
    async def case(_: DropFolder, scanner: FileDropScanner) -> None:
        assert [thread for thread in threading.enumerate() if "folder" in thread.name]
        capture = asyncio.create_task(scanner.capture("rotor"))
        await asyncio.sleep(0.3)
        await scanner.close()
        with pytest.raises(NotConnected, match="closed"):
            await capture
        assert not [thread for thread in threading.enumerate() if "folder" in thread.name]
        with pytest.raises(NotConnected):
            await scanner.safe()

    on_wire(case)


def test_another_scanner_is_refused() -> None:
    async def case(_: DropFolder, scanner: FileDropScanner) -> None:
        other = FileDropScanner("scanner", scanner._entry.model_copy(update={"serial": "SL-9"}))
        try:
            with pytest.raises(DeviceRefused, match="scanner scanner-1 answers, SL-9 is meant"):
                await other.connect()
        finally:
            await other.close()

    on_wire(case)


def test_a_file_system_that_hangs_holds_up_nobody(tmp_path: Path) -> None:
    async def main() -> None:
        folder, hang = Folder(tmp_path, 0.05), threading.Event()
        folder.open()
        with pytest.raises(TimeoutError):
            await folder.work(hang.wait)
        with pytest.raises(TimeoutError):
            await folder.put("a", b"x")
        await folder.close()
        hang.set()

    asyncio.run(main())
    for thread in threading.enumerate():
        if "folder" in thread.name:
            thread.join(5.0)


WIRE = WireBackend(wire_scanner.installed)


@pytest.mark.parametrize("case", (*CONNECTED, *UNANSWERED))
def test_it_is_a_device_like_any_other(case: DeviceCase) -> None:
    case(WIRE, "scanner")
