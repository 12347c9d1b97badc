"""A calibration is of the devices with which it was made: with another one in their place nothing moves."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from cellctl.api.auth import DemoAuth
from cellctl.app import _services
from cellctl.calibrated_devices import other_devices, told
from cellctl.calibrating.entry import require_same_devices
from cellctl.calibration import Calibration, Made, Procedure, load_calibration
from cellctl.controller import Snapshot
from cellctl.records.verify import read_record
from cellctl.runner import RunRequest, run_once
from cellctl.service_rules import Settings
from cellctl.states import State
from cellctl.vision.part import Refused
from cellctl.workplace import open_workplace, run_on_twin
from hal.clock import QuickenedLoop
from hal.interfaces import Identity
from tests.calibrating.perturbed import believing
from tests.calibrating.test_file import NOW, OLD
from tests.journeys.twin_runs import ROOT, small_recipe, twin_cell

FORCE = Identity("Maker", "load cell", "F-7", "2.1", simulated=False)
SCANNER = Identity("Seer", "structured light", "S-9", "1.0", simulated=False)
PRESENT = {"jack_force": FORCE, "scanner": SCANNER}


def made_with(part: Procedure, device: str, line: str) -> Calibration:
    made = Made(at=NOW, devices={device: line}, stops=5)
    return OLD.model_copy(update={"made": {part: made}})


def test_the_same_device_with_other_firmware_is_the_same() -> None:
    assert other_devices(made_with("force", "jack_force", told(replace(FORCE, firmware="1.0"))), PRESENT) == ()


@pytest.mark.parametrize("other", [{"serial": "F-8"}, {"model": "beam"}, {"vendor": "Somebody"}])
def test_another_device_is_named_with_what_was_recorded_and_what_is_there(other: dict[str, str]) -> None:
    before = replace(FORCE, **other)
    (said,) = other_devices(made_with("force", "jack_force", told(before)), PRESENT)
    assert said.startswith("jack_force: part force")
    assert f"was made with {before.vendor} {before.model}, serial {before.serial}; " in said
    assert said.endswith("here is Maker load cell, serial F-7")


def test_every_part_is_looked_at_but_the_one_that_is_made_anew() -> None:
    force, camera = (
        Made(at=NOW, devices={device: f"other, serial {device}, firmware 1"}, stops=5) for device in PRESENT
    )
    calibration = OLD.model_copy(update={"made": {"force": force, "camera": camera}})
    assert [said.partition(":")[0] for said in other_devices(calibration, PRESENT)] == ["jack_force", "scanner"]
    assert [said.partition(":")[0] for said in other_devices(calibration, PRESENT, but="force")] == ["scanner"]
    with pytest.raises(Refused, match="other_devices"):
        require_same_devices(calibration, "force", PRESENT)


def test_a_calibration_that_records_none_is_of_any() -> None:
    fake = load_calibration(ROOT / "deploy/calibration.fake.toml")
    assert fake.made == {}
    assert other_devices(fake, PRESENT) == ()


def test_a_run_is_refused_before_anything_moves(tmp_path: Path) -> None:
    other = made_with("force", "jack_force", "cellctl load cell, serial F-7, firmware 1.0")
    config = believing(twin_cell(), other, tmp_path)
    outcome = run_once(RunRequest(small_recipe(), config, 1, tmp_path / "data", keep="none"))
    assert (outcome.state, outcome.verdict) == ("Stopped", "held")
    assert outcome.record is not None
    assert "intent" not in {row.kind for row in read_record(outcome.record)[0]}
    (reason,) = outcome.reasons
    assert "jack_force" in reason
    assert "serial F-7" in reason
    assert "serial jack_force-1" in reason


def test_a_service_is_not_ready_with_another_device_and_says_which(tmp_path: Path) -> None:
    other = made_with("force", "jack_force", "cellctl load cell, serial F-7, firmware 1.0")
    config = believing(twin_cell(), other, tmp_path)
    settings = Settings(cell=config.path, data=tmp_path / "data", recipes=ROOT / "recipes")

    async def main() -> Snapshot:
        async with AsyncExitStack() as stack:
            services = await _services(stack, settings, config, DemoAuth(), open_workplace)
            await services.controller.until(State.STOPPED, State.IDLE, State.ABORTED)
            assert services.not_ready() == services.controller.snapshot().why
            return services.controller.snapshot()

    with asyncio.Runner(loop_factory=lambda: QuickenedLoop(100.0)) as runner:
        now = runner.run(main())
    assert now.state is State.STOPPED
    assert "serial F-7" in now.why
    assert "serial jack_force-1" in now.why


def test_a_dry_run_asks_for_no_device(tmp_path: Path) -> None:
    other = made_with("force", "jack_force", "Maker load cell, serial F-7, firmware 1.0")
    outcome = run_on_twin(small_recipe(), believing(twin_cell(), other, tmp_path), 3)
    assert "serial" not in "; ".join(outcome.reasons)
    assert outcome.phases_s
