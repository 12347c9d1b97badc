"""Quickened clocks and the demo's sign-in stay with fakes on this machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from cellctl.service_rules import Settings, clock, loopback, real_devices, refuse_unfit
from cellctl.workplace import refused_sign_in
from hal.clock import QuickenedLoop
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError
from hal.interfaces import Identity


def settings(**changes: object) -> Settings:
    return Settings(**({"cell": Path("c"), "data": Path("d"), "recipes": Path("r")} | changes))  # type: ignore[arg-type]


def with_a_real_gun(config: CellConfig) -> CellConfig:
    gun = config.devices.gun_a.model_copy(update={"kind": "open_protocol"})
    return config.model_copy(update={"devices": config.devices.model_copy(update={"gun_a": gun})})


@pytest.fixture
def fake(root: Path) -> CellConfig:
    return load_cell(root / "deploy/cell.fake.toml")


def test_fakes_on_this_machine_may_be_quickened(fake: CellConfig) -> None:
    assert real_devices(fake) == []
    refuse_unfit(settings(speed=60.0), fake)
    refuse_unfit(settings(host="::1"), fake)


def test_one_real_device_keeps_the_clock_as_it_is(fake: CellConfig) -> None:
    config = with_a_real_gun(fake)
    with pytest.raises(ConfigError, match=r"--speed.*gun_a"):
        refuse_unfit(settings(speed=2.0), config)
    refuse_unfit(settings(), config)
    loops = [clock(1.0, fake), clock(1.0, config)]
    for loop in loops:
        loop.close()
    assert [isinstance(loop, QuickenedLoop) for loop in loops] == [True, False]


def test_the_demo_is_for_devices_that_say_that_they_are_simulated() -> None:
    told = Identity("cellctl", "gun", "1", "1", simulated=True)
    metal = Identity("Vendor", "gun", "1", "1", simulated=False)
    assert refused_sign_in("demo", {"gun_a": told}) == ""
    assert "gun_b" in refused_sign_in("demo", {"gun_a": told, "gun_b": metal})


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "::", "cell.local", ""])
def test_the_demo_is_not_served_to_others(fake: CellConfig, host: str) -> None:
    assert not loopback(host)
    with pytest.raises(ConfigError, match="--host"):
        refuse_unfit(settings(host=host), fake)


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_a_senseless_speed_is_refused(fake: CellConfig, speed: float) -> None:
    with pytest.raises(ConfigError, match="--speed"):
        refuse_unfit(settings(speed=speed), fake)
