"""A gun of another maker in the wire cell: an entry in the cell file is all it takes."""

from __future__ import annotations

import socket
from pathlib import Path

from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.twin import twin_of
from hal.config import CellConfig, load_cell
from hal.entries import KducerEntry
from hal.fake.wire.gun_memory import TurnProgram
from hal.fake.wire.kducer import KducerController
from hal.fake.wire.stand import standing
from hal.jobs import InlineJobs
from hal.real.build import real_devices
from hal.real.kducer import KducerGun
from tests.contract.backends import quickened
from tests.journeys.twin_runs import RECIPE
from tests.journeys.wire_runs import CATCH_UP_S

GUNS = ("gun_a", "gun_b")


def cell_with_kolvers(root: Path) -> CellConfig:
    """The wire cell, its guns replaced, everything else on fakes."""
    wire = load_cell(root / "deploy/cell.wire.toml").on_fakes()
    entries: dict[str, KducerEntry] = {}
    for name in GUNS:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        entries[name] = KducerEntry(kind="kducer", host="127.0.0.1", port=port, lever_s=0.6)
    return wire.model_copy(update={"devices": wire.devices.model_copy(update=entries)})


def test_an_entry_of_the_cell_file_is_a_gun_and_its_simulator(root: Path) -> None:
    config, recipe = cell_with_kolvers(root), load_recipe(RECIPE)
    programs = programs_of(recipe.tighten)
    turn = next(program for program in programs if isinstance(program, TurnProgram))

    async def main() -> None:
        twin = twin_of(recipe, config, InlineJobs(), seed=1)
        async with standing(config, twin.plant, twin.faults, twin.render, programs) as stand:
            guns = real_devices(config).devices
            assert set(guns) == set(stand.guns) == set(GUNS)
            for name, gun in guns.items():
                assert isinstance(gun, KducerGun)
                assert isinstance(stand.guns[name], KducerController)
                assert (await gun.connect()).simulated
                turned = await gun.turn(turn.angle_deg, speed_rpm=turn.speed_rpm, torque_limit_nm=turn.torque_limit_nm)
                assert abs(turned.angle_deg - turn.angle_deg) <= 1.0
                assert len(stand.guns[name].starts) == 1
                await gun.close()

    quickened(main(), 100.0, CATCH_UP_S)


def test_the_same_cell_on_fakes(root: Path) -> None:
    assert set(cell_with_kolvers(root).on_fakes().kinds.values()) == {"fake"}
