"""What `cellctl simulate --truth DIR` keeps: how the parts that are in really stand, whole files only."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

from cellctl.recipe import load_recipe
from cellctl.truth_files import RENEWED_S, keeping_truth
from cellctl.twin import truth_limits, twin_of
from hal.clock import VirtualLoop
from hal.config import load_cell
from hal.jobs import InlineJobs
from tests.journeys.twin_runs import CELL, RECIPE


def test_the_truth_of_each_pair_of_parts_is_kept_beside_the_controller(tmp_path: Path) -> None:
    async def main() -> None:
        recipe = load_recipe(RECIPE)
        plant = twin_of(recipe, load_cell(CELL), InlineJobs(), seed=3).plant
        async with keeping_truth(tmp_path / "truth", plant, truth_limits(recipe)):
            plant.load_parts("R/1", "S-1")
            await asyncio.sleep(2.0 * RENEWED_S)
            plant.load_parts("R-2", "S-2")

    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        runner.run(main())
    kept = sorted(path.name for path in (tmp_path / "truth").iterdir() if path.name.startswith("R"))
    assert kept == ["R%2F1-S-1.json", "R-2-S-2.json"]
    told = json.loads((tmp_path / "truth" / "R-2-S-2.json").read_text())
    assert not told["good"]
    assert "not all studs are inserted" in told["reasons"]
    assert len(told["preload_n"]) == 36


def test_the_limits_of_a_good_joint_are_those_of_its_recipe() -> None:
    bench = truth_limits(load_recipe(RECIPE.parent / "wire_bench.toml"))
    assert (bench.preload_low_n, bench.preload_high_n) == (5000.0, 17000.0)
    assert truth_limits(load_recipe(RECIPE)).preload_high_n == 32000.0
