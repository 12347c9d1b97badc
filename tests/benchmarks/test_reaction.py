"""The reaction benchmark: its stand trips a guard and hears the stop, and delays are kept and compared."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from random import Random

import pytest

from hal.bus.can import CanBus
from hal.guard.process import GuardProcess
from tests.benchmarks.reaction import Delays, compared, keep
from tests.benchmarks.reaction_stand import LATEST_S, standing


def test_the_stand_trips_a_guard_again_and_again_and_hears_each_stop() -> None:
    async def main() -> list[float]:
        async with standing() as stand:
            assert stand.cell.can is not None
            guard = GuardProcess(stand.cell, CanBus(stand.cell.can.described, node=stand.cell.can.node))
            await guard.start()
            try:
                return await stand.guarded(3, Random(1))
            finally:
                await guard.close()

    seconds = asyncio.run(main())
    assert len(seconds) == 3
    assert all(0.0 < one < LATEST_S for one in seconds)


def test_delays_are_kept_in_order_and_compared_at_p99(tmp_path: Path) -> None:
    ways = {"floor": 1e-3, "process": 2e-3, "thread": 4e-3, "together": 20e-3, "open3d": 1.0}
    measured = {name: Delays([3.0 * s] + [s] * 999, answered=[299.0, 300.0, 301.0]) for name, s in ways.items()}
    found = compared({name: one.told() for name, one in measured.items()})
    assert found["process"] == pytest.approx(
        {"trials": 1000, "p50_ms": 2.0, "p99_ms": 2.0, "max_ms": 6.0, "answered_per_s": 300.0}
    )
    ratios = [found[f"{name}_to_process"] for name in ("thread", "together", "open3d")]
    assert ratios == pytest.approx([2.0, 10.0, 500.0])
    assert found["process_to_floor"] == pytest.approx(2.0)
    keep(measured, tmp_path / "delays.json")
    assert json.loads((tmp_path / "delays.json").read_text())["process"]["ms"] == [2.0] * 999 + [6.0]
