import asyncio
from datetime import UTC, datetime

from cellctl.stamps import EPOCH, Stamps, VirtualStamps, WallStamps, rfc3339
from hal.clock import run_virtual


def test_virtual_wall_clock_starts_in_2000_and_follows_the_loop() -> None:
    async def main() -> tuple[datetime, datetime, float]:
        stamps = VirtualStamps(1)
        first = stamps.now()
        await asyncio.sleep(90.5)
        return first, stamps.now(), stamps.cell_time_s()

    first, later, cell_time_s = run_virtual(main())
    assert first == EPOCH
    assert rfc3339(later) == "2000-01-01T00:01:30.500000Z"
    assert cell_time_s == 90.5


def test_virtual_ids_follow_from_seed_and_start_and_never_repeat() -> None:
    def ids(seed: int, start: int = 0) -> list[str]:
        stamps = VirtualStamps(seed, start=start)
        return [stamps.new_id("gun_a") for _ in range(200)]

    assert ids(1) == ids(1)
    assert len({*ids(1), *ids(2), *ids(1, start=1)}) == 600
    assert all(name.startswith("gun_a-") for name in ids(1))


def test_wall_stamps_are_utc_with_cell_time_from_zero() -> None:
    async def main() -> tuple[datetime, float, float]:
        stamps: Stamps = WallStamps()
        start = stamps.cell_time_s()
        await asyncio.sleep(2.0)
        return stamps.now(), start, stamps.cell_time_s()

    now, start, end = run_virtual(main())
    assert abs((now - datetime.now(UTC)).total_seconds()) < 60
    assert (start, end) == (0.0, 2.0)
    assert WallStamps().new_id("run") != WallStamps().new_id("run")
