"""The cell over the devices' own protocols: simulators of a whole cell file, and the controller beside them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest

from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.records.summary import value_of
from cellctl.records.verify import read_record, verify
from cellctl.twin import twin_of
from hal.cell import Cell, build_cell
from hal.config import CellConfig
from hal.entries import GentlEntry
from hal.errors import ConfigError, DeviceError, SafetyOpen
from hal.fake.wire.stand import Stand, standing
from hal.interfaces import View
from hal.jobs import InlineJobs
from tests.contract.backends import quickened
from tests.journeys.twin_runs import RECIPE, small_recipe
from tests.journeys.wire_runs import CATCH_UP_S, assembled_over_the_wire, free_ports, wire_cell

BRISK = {"pdo_s": 1.0, "heartbeat_s": 1.0, "rate_hz": 100.0}
"""Fewer messages than in a hall, for a loop that is to run fast."""


def on_wires(folder: Path, case: Callable[[Cell, Stand], Awaitable[None]]) -> None:
    """Run `case` on a connected cell; no task may be left."""

    async def main() -> None:
        config, recipe = wire_cell(folder, **BRISK), load_recipe(RECIPE)
        twin = twin_of(recipe, config, InlineJobs(), seed=1)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)) as stand:
            cell = build_cell(config)
            try:
                identities = await cell.connect()
                assert len(identities) == len(config.kinds)
                assert all(identity.simulated for identity in identities.values())
                await case(cell, stand)
            finally:
                await cell.close()

    quickened(main(), 100.0, CATCH_UP_S)


def test_every_device_of_the_wire_cell_connects_moves_and_is_made_safe(tmp_path: Path) -> None:
    async def case(cell: Cell, stand: Stand) -> None:
        await cell.rearm()
        await cell.gun_feed.home()
        await cell.jack.home()
        await cell.stage_x.home()
        assert (await cell.stage_x.move_to(1.0, speed=2.0)).position == pytest.approx(1.0, abs=0.01)
        report = await cell.make_safe(2.0)
        assert report.safe, report
        with pytest.raises(SafetyOpen, match="re-armed"):
            await cell.stage_x.move_to(0.0, speed=2.0)
        await cell.rearm()
        assert (await cell.stage_x.move_to(0.0, speed=2.0)).position == pytest.approx(0.0, abs=0.01)

    on_wires(tmp_path, case)


def test_drives_stop_when_the_heartbeat_does(tmp_path: Path) -> None:
    async def case(cell: Cell, stand: Stand) -> None:
        await cell.rearm()
        await cell.gun_feed.home()
        await cell.jack.home()
        assert cell.heartbeat is not None
        moving = asyncio.create_task(cell.jack.move_to(300.0, speed=10.0))
        await asyncio.sleep(5.0)
        await cell.heartbeat.close()
        await asyncio.sleep(4.0)
        here = (await cell.jack.read()).position
        assert 10.0 < here < 100.0
        with pytest.raises(DeviceError):
            await moving
        await asyncio.sleep(2.0)
        assert (await cell.jack.read()).position == pytest.approx(here, abs=1e-3)

    on_wires(tmp_path, case)


def test_nothing_is_simulated_on_another_machine(tmp_path: Path) -> None:
    async def main() -> None:
        config, recipe = wire_cell(tmp_path), load_recipe(RECIPE)
        gun = config.devices.gun_a.model_copy(update={"host": "192.0.2.7"})
        elsewhere = config.model_copy(update={"devices": config.devices.model_copy(update={"gun_a": gun})})
        twin = twin_of(recipe, elsewhere, InlineJobs(), seed=1)
        with pytest.raises(ConfigError, match=r"gun_a.*192\.0\.2\.7"):
            async with standing(elsewhere, twin.plant, twin.faults, twin.render, ()):
                pass

    quickened(main(), 100.0, CATCH_UP_S)


def with_camera(config: CellConfig, producer: str) -> CellConfig:
    """The same cell with a scanner behind GenTL."""
    sets: dict[View, str] = {"rotor": "rotor", "shaft": "shaft"}
    camera = GentlEntry(kind="gentl", producer=producer, user_sets=sets, reply_s=1000.0)
    return config.model_copy(update={"devices": config.devices.model_copy(update={"scanner": camera})})


def test_a_scanner_behind_gentl_is_simulated_at_the_address_of_its_producer(tmp_path: Path) -> None:
    async def main() -> None:
        recipe = load_recipe(RECIPE)
        config = with_camera(wire_cell(tmp_path), f"socket://127.0.0.1:{free_ports()(0)}")
        assert config.on_fakes().devices.scanner.kind == "fake"
        twin = twin_of(recipe, config, InlineJobs(), seed=1)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)):
            cell = build_cell(config)
            try:
                assert (await cell.scanner.connect()).model == "twin structured light (GenTL)"
                twin.plant.camera = "rotor"
                frame = await cell.scanner.capture("rotor")
                assert frame.points_mm.shape[2] == 3
                assert np.isfinite(frame.points_mm).all(axis=2).mean() > 0.1
            finally:
                await cell.close()

    quickened(main(), 100.0, CATCH_UP_S)


@pytest.mark.parametrize("producer", ["socket://192.0.2.7:4444", "/opt/maker/maker.cti"])
def test_a_camera_elsewhere_is_not_simulated(tmp_path: Path, producer: str) -> None:
    async def main() -> None:
        recipe, config = load_recipe(RECIPE), with_camera(wire_cell(tmp_path), producer)
        twin = twin_of(recipe, config, InlineJobs(), seed=1)
        with pytest.raises(ConfigError, match="scanner"):
            async with standing(config, twin.plant, twin.faults, twin.render, ()):
                pass

    quickened(main(), 100.0, CATCH_UP_S)


@pytest.mark.nightly  # 75 s of CPU
def test_a_small_assembly_over_the_wire_is_accepted(tmp_path: Path) -> None:
    config = wire_cell(tmp_path, **BRISK)
    outcome, truth = assembled_over_the_wire(small_recipe(4), config, tmp_path / "data")
    assert outcome.verdict == "accepted", (outcome.state, outcome.reasons)
    assert truth.good, truth.reasons
    assert outcome.summary is not None
    assert outcome.record is not None
    found = verify(outcome.record)
    assert found.ok, found.reasons
    header = value_of(read_record(outcome.record)[0], "run")
    assert header is not None
    assert header["backends"] == dict(config.kinds)
    assert "fake" not in header["backends"].values()
