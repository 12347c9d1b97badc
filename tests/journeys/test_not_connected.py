"""A service whose devices are not there: it rests, says which and why, and has them once they are there and a person
clears."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from pathlib import Path

from cellctl.api.auth import DemoAuth
from cellctl.api.services import Services
from cellctl.app import _services
from cellctl.gun_programs import programs_of
from cellctl.recipe import load_recipe
from cellctl.service_rules import Settings
from cellctl.states import Command, State
from cellctl.twin import twin_of
from cellctl.workplace import open_workplace
from hal.config import CellConfig
from hal.entries import Devices
from hal.fake.wire.stand import standing
from hal.jobs import InlineJobs
from tests.contract.backends import quickened
from tests.journeys.test_wire_cell import BRISK
from tests.journeys.twin_runs import RECIPE, ROOT
from tests.journeys.wire_runs import CATCH_UP_S, wire_cell


def served(folder: Path, case: Callable[[CellConfig, Services], Awaitable[None]]) -> None:
    """Run `case` on a service of the wire cell, without its HTTP server, begun while nothing answers."""

    async def main() -> None:
        config = wire_cell(folder, **BRISK)
        settings = Settings(cell=config.path, data=folder / "data", recipes=ROOT / "recipes")
        async with AsyncExitStack() as stack:
            services = await _services(stack, settings, config, DemoAuth(), open_workplace)
            await case(config, services)

    quickened(main(), 100.0, CATCH_UP_S)


def states_of(services: Services) -> list[str]:
    """Every state that was entered, in order."""
    return [str(event.data["state"]) for event in services.events.since(0) if event.kind == "state"]


def test_it_rests_aborted_and_names_every_device_with_its_address(tmp_path: Path) -> None:
    async def case(config: CellConfig, services: Services) -> None:
        controller = services.controller
        await controller.until(State.ABORTED, State.STOPPED, State.IDLE)
        now = controller.snapshot()
        assert (now.state, now.allowed) == (State.ABORTED, (Command.CLEAR,))
        assert now.why.startswith("26 of 26 devices did not connect")
        assert all(name in now.why for name in Devices.model_fields)
        assert config.can is not None
        addresses = (config.can.channel, f"127.0.0.1:{config.devices.gun_a.port}", str(config.devices.jack_force.path))
        assert all(address in now.why for address in addresses), now.why
        assert now.why == services.not_ready()
        assert states_of(services) == ["Aborting", "Aborted"]

    served(tmp_path, case)


def test_devices_that_have_come_are_connected_when_a_person_clears(tmp_path: Path) -> None:
    async def case(config: CellConfig, services: Services) -> None:
        controller, recipe = services.controller, load_recipe(RECIPE)
        await controller.until(State.ABORTED)
        controller.request(Command.CLEAR)
        await controller.until(State.ABORTED, State.STOPPED)
        now = controller.snapshot()
        assert (now.state, now.why) == (State.ABORTED, services.not_ready())
        assert "26 of 26 devices did not connect" in now.why
        twin = twin_of(recipe, config, InlineJobs(), seed=1)
        async with standing(config, twin.plant, twin.faults, twin.render, programs_of(recipe.tighten)):
            controller.request(Command.CLEAR)
            assert await controller.until(State.ABORTED, State.STOPPED) is State.STOPPED, controller.snapshot().why
            assert controller.snapshot().alarms == ()
            controller.request(Command.RESET)
            assert await controller.until(State.IDLE, State.ABORTED, State.STOPPED) is State.IDLE
            assert services.not_ready() == ""
            await controller.shutdown()

    served(tmp_path, case)
