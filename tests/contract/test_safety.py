"""The contract of the mirror of the safety circuit."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceTimeout
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_everything_closed_is_ok(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("safety") as bench:
            state = await bench.device.read()
            assert state.ok
            assert state.time_s == pytest.approx(asyncio.get_running_loop().time(), abs=0.1)

    backend.run(main())


@pytest.mark.parametrize(
    ("kind", "field", "value", "power"),
    [
        ("estop", "estop_released", False, False),
        ("guard_open", "guards_closed", False, False),
        ("sto_open", "sto_released", False, False),
        ("channels_disagree", "estop_released", None, False),
        ("bench_unlocked", "bench_locked", False, True),
        ("bench_moved", "bench_moved", True, True),
    ],
)
def test_each_open_input_is_seen_and_stops_the_cell(
    backend: Backend, kind: str, field: str, value: bool | None, power: bool
) -> None:
    async def main() -> None:
        async with backend.bench("safety", Fault("safety", kind, at_s=1.0, duration_s=1.0)) as bench:
            assert (await bench.device.read()).ok
            await asyncio.sleep(1.5)
            state = await bench.device.read()
            assert not state.ok
            assert getattr(state, field) is value
            assert state.sto_released is power
            await asyncio.sleep(1.0)
            assert (await bench.device.read()).ok == (kind != "bench_moved")

    backend.run(main())


def test_a_moved_bench_stays_moved_until_it_is_rearmed_with_the_cause_gone(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("safety", Fault("safety", "bench_moved", at_s=1.0, duration_s=1.0)) as bench:
            await asyncio.sleep(1.5)
            await bench.device.rearm()
            assert (await bench.device.read()).bench_moved is True
            await asyncio.sleep(1.0)
            assert (await bench.device.read()).bench_moved is True
            await bench.device.rearm()
            assert (await bench.device.read()).ok

    backend.run(main())


def test_a_mirror_that_hangs_gives_no_old_answer(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("safety", Fault("safety", "hung", at_s=1.0)) as bench:
            await bench.device.read()
            await asyncio.sleep(1.0)
            with pytest.raises(DeviceTimeout):
                await bench.device.read()

    backend.run(main())
