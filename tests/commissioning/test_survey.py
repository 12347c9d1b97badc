"""Every device is asked; what fails says why, and only that fails; nothing moves."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from cellctl.commissioning.bench import opened
from cellctl.commissioning.live import spoken
from cellctl.commissioning.survey import survey
from cellctl.twin import FakeCell
from hal.config import CellConfig
from hal.errors import DeviceRefused
from hal.fake.fault_file import Fault
from hal.fake.wire.stand import Stand
from hal.permits import AXES
from tests.commissioning.cells import CONFIG, on_fakes, on_wires
from tests.journeys.twin_runs import RECIPE


def fault(device: str, kind: str, value: float | None = None) -> Fault:
    return Fault(device=device, kind=kind, value=value, at_s=0.0)


def test_all_fakes_answer_and_nothing_moves() -> None:
    async def case(fake: FakeCell) -> None:
        found = await survey(fake.cell, CONFIG)
        assert [one.name for one in found] == list(CONFIG.entries)
        assert [one.name for one in found if one.error] == []
        assert all(one.identity is not None and one.identity.simulated for one in found)
        by_name = {one.name: one for one in found}
        assert by_name["jack_force"].values["force_n"] == pytest.approx(980.0, rel=0.05)
        assert by_name["spigot_tc_1"].values["temperature_c"] == pytest.approx(20.0, abs=1.0)
        assert by_name["heater"].values["on"] is False
        assert by_name["chuck"].health == by_name["safety"].health == "good"
        for name in AXES:
            assert by_name[name].values["homed"] is False
            assert (
                fake.plant.motion[name].position(1e9)
                == by_name[name].values[f"position_{getattr(fake.cell, name).unit}"]
            )

    on_fakes(case)


@pytest.mark.parametrize(
    ("planted", "code", "told"),
    [
        (fault("jack", "gone"), "device_not_connected", "link"),
        (fault("gun_a", "hung"), "device_timeout", "no answer"),
        (fault("jack_force", "nan"), "guard_tripped", "not a number"),
        (fault("jack_force", "gone"), "device_not_connected", "link"),
        (fault("scanner", "gone"), "device_not_connected", "link"),
    ],
)
def test_what_fails_says_why_and_alone(planted: Fault, code: str, told: str) -> None:
    async def case(fake: FakeCell) -> None:
        failed = {one.name: one for one in await survey(fake.cell, CONFIG) if one.error}
        assert set(failed) == {planted.device}
        assert failed[planted.device].code == code
        assert told in failed[planted.device].error

    on_fakes(case, planted)


@pytest.mark.parametrize(
    ("planted", "health"),
    [
        (fault("spigot_tc_1", "nan"), "the reading is bad"),
        (fault("gun_force_a", "stuck"), "stands still"),
        (fault("chuck", "disagree"), "feedbacks disagree"),
        (fault("safety", "estop"), "emergency stop open"),
        (fault("safety", "channels_disagree"), "emergency stop unknown"),
    ],
)
def test_what_a_device_calls_wrong_is_its_health(planted: Fault, health: str) -> None:
    async def case(fake: FakeCell) -> None:
        found = {one.name: one for one in await survey(fake.cell, CONFIG)}[planted.device]
        assert found.error == ""
        assert health in found.health

    on_fakes(case, planted)


def test_a_wire_cell_is_asked_over_its_protocols_again_and_again(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        async with opened(config, RECIPE) as cell:
            found = await survey(cell, config)
            assert {one.name: one.error for one in found if one.error} == {}
            assert found[0].address.endswith("node 1")
            await stand.guns["gun_a"].close()
            await stand.scanners["scanner"].close()
            stand.forces["gun_force_b"].unplug()
            await stand.hub.unplug()
            failed = {one.name: one.error for one in await survey(cell, config) if one.error}
            assert set(failed) == {"gun_a", "scanner", "gun_force_b", *AXES}
            assert all(failed.values())

    on_wires(tmp_path, case)


def test_a_bus_that_has_a_controller_gets_no_second_one(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        async with opened(config, RECIPE) as cell:
            await cell.stage_x.connect()
            with pytest.raises(DeviceRefused, match=r"node 127 is at work.*one controller"):
                async with opened(config, RECIPE):
                    pass
        async with opened(config, RECIPE):
            pass

    on_wires(tmp_path, case)


def test_two_commands_that_come_at_once_are_kept_apart(tmp_path: Path) -> None:
    async def case(config: CellConfig, stand: Stand) -> None:
        config.path.parent.mkdir(exist_ok=True)
        config.path.write_text("# held while devices are in hand", encoding="utf-8")

        async def one() -> str:
            try:
                async with opened(config, RECIPE) as cell:
                    await cell.stage_x.connect()
            except DeviceRefused as error:
                return error.reason
            return ""

        first, second = await asyncio.gather(one(), one())
        assert first == ""
        assert second == "cell.wire.toml: another command has this cell's devices in hand"
        assert await one() == ""

    on_wires(tmp_path, case)


def test_values_are_spoken_with_their_units() -> None:
    values = {
        "position_mm": -0.0,
        "velocity_deg_s": 1.25,
        "force_n": 981.24,
        "homed": True,
        "gap_mm": None,
        "nuts": 4,
    }
    assert spoken(values) == ("position 0.000 mm, velocity 1.250 deg/s, force 981.2 N, homed yes, gap unknown, nuts 4")
