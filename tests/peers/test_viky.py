"""The GenTL backend against viky.cti, a producer from the PyPI wheel genicam that shows a 3D game."""

from __future__ import annotations

import asyncio
import importlib.util
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hal.entries import GentlEntry
from hal.errors import DeviceRefused, DeviceTimeout, Interrupted, NotConnected
from hal.real.gentl import GentlScanner
from tests.contract.backends import alone
from tests.peers.peers import met_package

pytestmark = pytest.mark.peers


def producer() -> str:
    found = importlib.util.find_spec("genicam")
    assert found is not None
    assert found.origin is not None
    path = Path(found.origin).with_name("viky.cti")
    assert path.is_file(), "the wheel genicam has no viky.cti"
    met_package("genicam")
    met_package("harvesters")
    return str(path)


def with_viky(case: Callable[[GentlScanner], Coroutine[Any, Any, None]], **changes: object) -> None:
    """Run `case` on a backend of viky's second camera, which takes no trigger; not connected."""

    async def main() -> None:
        entry = {"kind": "gentl", "producer": producer(), "serial": "1", "trigger": "free"}
        scanner = GentlScanner("scanner", GentlEntry.model_validate(entry | changes))
        try:
            await case(scanner)
        finally:
            await scanner.close()

    asyncio.run(alone(main()))


def test_it_gives_organised_clouds_in_millimetres() -> None:
    async def case(scanner: GentlScanner) -> None:
        identity = await scanner.connect()
        assert (identity.vendor, identity.model, identity.serial) == ("Machine Vision Games Ltd.", "Viky", "1")
        assert not identity.simulated
        assert await scanner.connect() == identity
        last, time_s = 0, 0.0
        columns, rows = np.meshgrid(np.arange(400.0), np.arange(400.0))
        for _ in range(20):
            frame = await scanner.capture("rotor")
            assert (frame.points_mm.shape, frame.points_mm.dtype) == ((400, 400, 3), np.float32)
            assert np.array_equal(frame.points_mm[..., 0], columns), "A counts columns"
            assert np.array_equal(frame.points_mm[..., 1], rows), "B counts rows"
            assert 0.0 < frame.points_mm[..., 2].max() < 1000.0
            assert frame.frame_id > last
            assert frame.time_s > time_s
            last, time_s = frame.frame_id, frame.time_s
            assert (await scanner.safe()).safe
        await scanner.rearm()

    with_viky(case)


def test_a_halt_ends_a_capture() -> None:
    async def case(scanner: GentlScanner) -> None:
        await scanner.connect()
        for _ in range(20):
            capture = asyncio.create_task(scanner.capture("rotor"))
            await asyncio.sleep(0.01)
            await scanner.halt()
            with pytest.raises(Interrupted):
                await capture
            assert (await scanner.safe()).safe
        assert (await scanner.capture("rotor")).points_mm.size

    with_viky(case)


def test_without_a_frame_in_time_it_says_so_and_goes_on() -> None:
    async def case(scanner: GentlScanner) -> None:
        await scanner.connect()
        with pytest.raises(DeviceTimeout, match="no frame within"):
            await scanner.capture("rotor")
        assert (await scanner.safe()).safe

    with_viky(case, frame_s=0.001)


@pytest.mark.parametrize(
    ("changes", "error", "reason"),
    [
        ({"serial": ""}, DeviceRefused, "the cell file must name one"),
        ({"serial": "77"}, NotConnected, "meant is 77"),
        ({"producer": "/nowhere.cti"}, NotConnected, "no GenTL producer"),
        ({"trigger": "software"}, DeviceRefused, "Trigger"),
    ],
)
def test_what_it_cannot_do_is_refused(changes: dict[str, str], error: type[Exception], reason: str) -> None:
    async def case(scanner: GentlScanner) -> None:
        with pytest.raises(error, match=reason):
            await scanner.connect()

    with_viky(case, **changes)
