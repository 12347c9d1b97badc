"""What every device of the cell must do, whatever its kind."""

from __future__ import annotations

import asyncio

import pytest

from hal.errors import DeviceTimeout, NotConnected
from hal.fake.faults import EXCHANGE_DEADLINE_S, Fault
from tests.contract.backends import Backend
from tests.contract.fakes import DEVICES

EVERY = pytest.mark.parametrize("name", DEVICES)
COMMANDS = ("halt", "safe", "rearm")
START_S = 5.0
"""Faults begin here: the link is up by then, on a wire too."""
GONE_S = 0.4
"""A link that is down shows at once; on a bus, where there is none, with the heartbeat that does not come."""
EXCHANGES = 3
"""A halt has no more of them, its read-back included."""


async def until(time_s: float) -> None:
    """Sleep until the loop's time is `time_s`."""
    await asyncio.sleep(time_s - asyncio.get_running_loop().time())


@EVERY
def test_it_says_who_it_is(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, connect=False) as bench:
            identity = await bench.device.connect()
            assert bench.device.name == name
            assert backend.simulated in (None, identity.simulated)
            assert all((identity.vendor, identity.model, identity.serial, identity.firmware))
            assert await bench.device.connect() == identity

    backend.run(main())


@EVERY
def test_at_rest_it_halts_is_safe_and_rearms(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name) as bench:
            await bench.device.halt()
            await bench.device.halt()
            state = await bench.device.safe()
            assert state.safe
            assert state.detail
            await bench.device.rearm()
            assert (await bench.device.safe()).safe

    backend.run(main())


@EVERY
@pytest.mark.parametrize("command", COMMANDS)
def test_gone_it_fails_at_once(backend: Backend, name: str, command: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "gone", at_s=START_S)) as bench:
            await until(START_S)
            loop = asyncio.get_running_loop()
            asked_s = loop.time()
            with pytest.raises(NotConnected, match=name):
                await getattr(bench.device, command)()
            assert loop.time() <= asked_s + GONE_S

    backend.run(main())


@EVERY
@pytest.mark.parametrize("command", COMMANDS)
def test_hung_it_misses_its_own_deadline_and_can_be_given_up(backend: Backend, name: str, command: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "hung", at_s=START_S)) as bench:
            await until(START_S)
            loop = asyncio.get_running_loop()
            asked_s = loop.time()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.1):
                    await getattr(bench.device, command)()
            assert loop.time() == pytest.approx(asked_s + 0.1, abs=0.1)
            with pytest.raises(DeviceTimeout, match=name):
                await getattr(bench.device, command)()
            assert loop.time() <= asked_s + 0.2 + 2 * EXCHANGE_DEADLINE_S

    backend.run(main())


@EVERY
def test_back_from_hanging_it_answers(backend: Backend, name: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, "hung", at_s=START_S, duration_s=0.5)) as bench:
            await until(START_S + 0.2)
            assert (await bench.device.safe()).safe
            assert asyncio.get_running_loop().time() == pytest.approx(START_S + 0.5, abs=0.1)

    backend.run(main())


@EVERY
@pytest.mark.parametrize("kind", ["gone", "hung"])
def test_it_does_not_connect_where_nothing_answers_and_always_closes(backend: Backend, name: str, kind: str) -> None:
    async def main() -> None:
        async with backend.bench(name, Fault(name, kind, duration_s=60.0), connect=False) as bench:
            with pytest.raises((NotConnected, DeviceTimeout)):
                await bench.device.connect()
            await bench.device.close()
            await bench.device.close()
            await asyncio.sleep(60.0)
            await bench.device.connect()
            assert (await bench.device.safe()).safe

    backend.run(main())


@EVERY
def test_slow_answers_within_the_deadline_are_still_answers(backend: Backend, name: str) -> None:
    async def main() -> None:
        late_s = 0.5 * EXCHANGE_DEADLINE_S
        async with backend.bench(name, Fault(name, "late", value=late_s, at_s=START_S)) as bench:
            await until(START_S)
            loop = asyncio.get_running_loop()
            asked_s = loop.time()
            await bench.device.halt()
            taken_s = loop.time() - asked_s
            assert late_s - 0.01 <= taken_s <= EXCHANGES * late_s + 0.1, "each exchange is late once"

    backend.run(main())
