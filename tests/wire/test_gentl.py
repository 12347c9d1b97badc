"""Faults of a camera behind GenTL: always the true error, never another request's frame, a loop that goes on."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import numpy as np
import pytest

from hal.errors import DeviceError, DeviceFault, DeviceRefused, DeviceTimeout, ImplausibleReading, NotConnected
from hal.fake.faults import Fault, FaultBook
from hal.fake.wire.gentl import SimulatedCamera
from hal.real.gentl import GentlScanner
from tests.contract import wire_gentl
from tests.contract.backends import WireBackend, plant_of, quickened
from tests.wire.as_device import CONNECTED, UNANSWERED, DeviceCase
from tests.wire.frames import each_goes_wrong_once

Case = Callable[[SimulatedCamera, GentlScanner], Coroutine[Any, Any, None]]
TIMES = 20
SPEED = 40.0


def on_wire(case: Case, *faults: Fault, speed: float = SPEED, reply_s: float = 10.0, **changes: object) -> None:
    """Run `case` on a simulated camera and its backend, connected, under quickened time, the arm in view rotor."""

    async def main() -> None:
        plant = plant_of("ideal")
        plant.camera = "rotor"
        async with wire_gentl.wired("scanner", plant, FaultBook(faults), reply_s=reply_s, **changes) as (
            camera,
            scanner,
        ):
            await scanner.connect()
            await case(camera, scanner)

    quickened(main(), speed)


@pytest.mark.parametrize(
    ("kind", "value", "error", "reason"),
    [
        ("half", 1, DeviceFault, "half a frame"),
        ("hang_up", 1, NotConnected, "hung up"),
        ("unit", "Meter", ImplausibleReading, "is in 'Meter', not in 'Millimeter'"),
    ],
)
def test_each_fault_has_its_error_and_the_next_frame_is_good(
    kind: str, value: object, error: type[DeviceError], reason: str
) -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        await each_goes_wrong_once(scanner, camera.wire, kind, value, error, reason, times=TIMES)
        assert camera.shots == 2 * TIMES, "nothing is asked twice"

    on_wire(case)


@pytest.mark.parametrize("layout", ["whole", "planar", "parts"])
def test_every_layout_of_the_buffer_gives_the_twins_cloud(layout: Any) -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        camera.wire.layout = layout
        cloud = (await scanner.capture("rotor")).points_mm
        assert cloud.shape == (4, 6, 3)
        assert cloud.flags.writeable
        assert len(np.unique(cloud)) == 1

    on_wire(case)


def test_a_frame_that_is_late_is_not_taken_for_the_next() -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        for _ in range(TIMES):
            with pytest.raises(DeviceTimeout, match="no frame within 1 s"):
                await scanner.capture("rotor")
        assert (await scanner.safe()).safe, "a frame that nobody waits for is stopped"
        assert camera.shots == TIMES

    on_wire(case, frame_s=1.0)


def test_given_up_by_its_caller_a_frame_is_not_taken_for_the_next() -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        for _ in range(TIMES):
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.5):
                    await scanner.capture("rotor")
        asked_s = asyncio.get_running_loop().time()
        frame = await scanner.capture("rotor")
        assert frame.time_s > asked_s
        assert frame.frame_id == 1, "none of those before was finished"
        assert camera.shots <= TIMES + 1

    on_wire(case)


def test_a_frame_number_that_has_not_grown_is_an_old_frame() -> None:
    async def case(_: SimulatedCamera, scanner: GentlScanner) -> None:
        good = await scanner.capture("rotor")
        await asyncio.sleep(20.0)
        old = await scanner.capture("rotor")
        assert old.frame_id == good.frame_id
        assert old.time_s <= good.time_s

    on_wire(case, Fault("scanner", "old_frame", at_s=10.0))


def test_the_cable_is_pulled_and_plugged_back() -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        last = 0
        for _ in range(TIMES):
            capture = asyncio.create_task(scanner.capture("rotor"))
            await asyncio.sleep(0.3)
            await camera.server.close()
            with pytest.raises(NotConnected):
                await capture
            for command in (scanner.halt, scanner.safe, scanner.rearm, partial(scanner.capture, "rotor")):
                with pytest.raises(NotConnected):
                    await command()
            await camera.server.start()
            frame = await scanner.capture("rotor")
            assert frame.frame_id > last, "numbers go on from link to link"
            last = frame.frame_id

    on_wire(case)


FEW = pytest.mark.parametrize("times", [3, pytest.param(TIMES, marks=pytest.mark.nightly)])
"""Each of these starts a process."""


@FEW
def test_a_producer_that_hangs_is_ended_with_its_process_and_the_loop_goes_on(times: int) -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        for _ in range(times):
            before = scanner._process.pid
            camera.wire.silent = 1
            command = asyncio.create_task(scanner.capture("rotor"))
            turns = 0
            while not command.done():
                await asyncio.sleep(0.1)
                turns += 1
            assert turns > 20, "others had their turns meanwhile"
            with pytest.raises(DeviceTimeout, match="no answer to capture within 4 s"):
                await command
            assert (await scanner.capture("rotor")).points_mm.size
            assert scanner._process.pid not in (None, before)

    on_wire(case, speed=10.0, reply_s=4.0)


@FEW
@pytest.mark.parametrize("kill", [signal.SIGKILL, signal.SIGSEGV])
def test_a_process_that_dies_is_told_and_replaced(kill: signal.Signals, times: int) -> None:
    async def case(_: SimulatedCamera, scanner: GentlScanner) -> None:
        for _ in range(times):
            pid = scanner._process.pid
            assert pid is not None
            capture = asyncio.create_task(scanner.capture("rotor"))
            await asyncio.sleep(0.3)
            os.kill(pid, kill)
            with pytest.raises(NotConnected, match="died"):
                await capture
            assert (await scanner.capture("rotor")).points_mm.size

    on_wire(case)


def test_closing_ends_a_capture_the_process_and_the_thread() -> None:
    async def case(_: SimulatedCamera, scanner: GentlScanner) -> None:
        pid = scanner._process.pid
        assert pid is not None
        capture = asyncio.create_task(scanner.capture("rotor"))
        await asyncio.sleep(0.3)
        await scanner.close()
        with pytest.raises(NotConnected):
            await capture
        assert not [thread for thread in threading.enumerate() if "camera" in thread.name]
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
        with pytest.raises(NotConnected):
            await scanner.safe()

    on_wire(case)


def test_what_is_no_request_is_hung_up_on_or_refused_and_others_go_on() -> None:
    async def case(camera: SimulatedCamera, scanner: GentlScanner) -> None:
        for line, answer in (
            (b"\n", b""),
            (b"[]\n", b""),
            (b"x" * 100_000, b""),
            (b'{"do": "dance"}\n', b'{"ok": false, "error": "refused"'),
        ):
            reader, writer = await asyncio.open_connection("127.0.0.1", camera.server.port)
            writer.write(line)
            with contextlib.suppress(ConnectionError):
                assert (await reader.read(100)).startswith(answer)
            writer.close()
        assert (await scanner.capture("rotor")).points_mm.size

    on_wire(case)


def test_another_camera_or_none_is_refused() -> None:
    async def case(_: SimulatedCamera, scanner: GentlScanner) -> None:
        entry = scanner._entry
        for changes, error, reason in (
            ({"serial": "SL-9"}, DeviceRefused, "camera scanner-1 answers, SL-9 is meant"),
            ({"producer": "socket://127.0.0.1:9"}, NotConnected, "no camera at"),
        ):
            other = GentlScanner("scanner", entry.model_copy(update=changes))
            try:
                with pytest.raises(error, match=reason):
                    await other.connect()
            finally:
                await other.close()

    on_wire(case)


CASES = [*((case, 5.0) for case in CONNECTED), *((case, 40.0) for case in UNANSWERED)]


@pytest.mark.parametrize(("case", "speed"), CASES)
def test_it_is_a_device_like_any_other(case: DeviceCase, speed: float) -> None:
    case(WireBackend(wire_gentl.installed, speed=speed), "scanner")
