"""The contract of a chuck."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceFault, Interrupted, NotConnected, SafetyOpen
from hal.fake.faults import Fault
from tests.contract.backends import Backend


def test_it_releases_and_clamps_with_both_feedbacks(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("chuck") as bench:
            opened = await bench.device.release()
            assert (opened.clamped_1, opened.clamped_2) == (False, False)
            assert not bench.plant.chuck_clamped
            assert asyncio.get_running_loop().time() > 0.5, "jaws take their time"
            closed = await bench.device.clamp()
            assert (closed.clamped_1, closed.clamped_2) == (True, True)
            assert closed.pressure_bar == pytest.approx(6.0)
            assert closed.time_s == pytest.approx(asyncio.get_running_loop().time(), abs=0.1)
            assert bench.plant.chuck_clamped
            before = asyncio.get_running_loop().time()
            assert (await bench.device.clamp()).clamped_1
            assert asyncio.get_running_loop().time() < before + 0.5, "clamped already"

    backend.run(main())


def test_a_halt_interrupts_the_jaws(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("chuck") as bench:
            await bench.device.clamp()
            release = asyncio.create_task(bench.device.release())
            await asyncio.sleep(0.2)
            assert not (await bench.device.safe()).safe
            state = await bench.device.read()
            assert not (state.clamped_1 and state.clamped_2), "never clamped on the way"
            await bench.device.halt()
            with pytest.raises(Interrupted):
                await release
            assert (await bench.device.safe()).safe

    backend.run(main())


@pytest.mark.parametrize(
    ("fault", "feedbacks"),
    [
        (Fault("chuck", "both_unset", at_s=5.0), (False, False)),
        (Fault("chuck", "disagree", at_s=5.0), (True, False)),
        (Fault("chuck", "opening", at_s=5.0), (False, False)),
        (Fault("chuck", "pressure_drop", value=1.0, at_s=5.0), (False, False)),
        (Fault("chuck", "pressure_drop", value=3.5, at_s=5.0), (True, True)),
    ],
)
def test_what_its_feedbacks_say_when_it_fails(backend: Backend, fault: Fault, feedbacks: tuple[bool, bool]) -> None:
    async def main() -> None:
        async with backend.bench("chuck", fault) as bench:
            await asyncio.sleep(6.0)
            opened = fault.kind == "opening" or fault.value == 1.0
            assert bench.plant.chuck_clamped != opened, "jaws open though nobody has looked"
            state = await bench.device.read()
            assert (state.clamped_1, state.clamped_2) == feedbacks
            if fault.value is not None:
                assert state.pressure_bar == fault.value
            if feedbacks != (True, True):
                with pytest.raises(DeviceFault, match="feedbacks"):
                    await bench.device.clamp()

    backend.run(main())


def test_no_power_no_jaws(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("chuck", Fault("safety", "estop")) as bench:
            with pytest.raises(SafetyOpen):
                await bench.device.release()
            assert bench.plant.chuck_clamped
            assert (await bench.device.read()).clamped_1

    backend.run(main())


def test_unconnected_it_answers_nothing(backend: Backend) -> None:
    async def main() -> None:
        async with backend.bench("chuck", connect=False) as bench:
            for command in (bench.device.read, bench.device.clamp, bench.device.release, bench.device.halt):
                with pytest.raises(NotConnected):
                    await command()

    backend.run(main())
