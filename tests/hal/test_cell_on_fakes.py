"""The built cell on the twin: stopped at random instants with everything under way, and what its rules let through."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hal.cell import Behind, Cell, build_cell
from hal.clock import run_virtual
from hal.config import load_cell
from hal.entries import Devices
from hal.errors import CellError, DeviceRefused, SafetyOpen
from hal.fake.devices.guns import install_joints
from hal.fake.devices.heating import install_heat
from hal.fake.faults import Fault, FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant, TwinSettings
from hal.fake.scene.render import SceneState
from hal.interfaces import GuardLimits
from hal.permits import AXES

CONFIG = load_cell(Path(__file__).parents[2] / "deploy" / "cell.fake.toml")
DEADLINE_S = CONFIG.cell.safe_deadline_s
READY_S = 12.0
"""By then every axis is homed."""
GUARD = GuardLimits("any", tare_n=1000.0, trip_n=900.0, low_n=-900.0, stale_ms=50.0, block=10)


async def picture(scene: SceneState, seed: int) -> NDArray[np.float32]:
    return np.zeros((2, 2, 3), dtype=np.float32)


async def built(*faults: Fault) -> tuple[Cell, Plant]:
    plant = Plant(JointGeometry(tuple(30.0 * i for i in range(12))), TwinSettings(5, "nominal"))
    install_heat(plant)
    install_joints(plant)
    cell = build_cell(CONFIG, Behind(plant, FaultBook(faults), picture))
    await cell.connect()
    for name in ("gun_feed", "gun_table", "jack", "stage_x", "stage_y", "shaft_table"):
        await getattr(cell, name).home()
    await asyncio.sleep(READY_S - asyncio.get_running_loop().time())
    return cell, plant


def jobs(cell: Cell, rng: np.random.Generator) -> list[Callable[[], Awaitable[object]]]:
    """One of everything that acts."""
    return [
        lambda: cell.jack.move_to(float(rng.uniform(0, 355)), speed=float(rng.uniform(1, 20))),
        lambda: cell.stage_x.move_to(float(rng.uniform(-10, 10)), speed=float(rng.uniform(0.5, 5))),
        lambda: cell.stage_y.move_to(float(rng.uniform(-10, 10)), speed=float(rng.uniform(0.5, 5))),
        lambda: cell.shaft_table.move_to(float(rng.uniform(-150, 150)), speed=float(rng.uniform(1, 10))),
        lambda: cell.gun_table.move_to(float(rng.uniform(0, 360)), speed=float(rng.uniform(5, 60))),
        lambda: cell.heater.heat(60.0, ramp_k_per_min=10.0, max_power_w=3000.0),
        lambda: cell.gun_a.turn(720.0, speed_rpm=10.0, torque_limit_nm=5.0),
        lambda: cell.gun_b.turn(-360.0, speed_rpm=5.0, torque_limit_nm=5.0),
        lambda: cell.camera_park.go("shaft" if rng.random() < 0.5 else "parked"),
        lambda: cell.nut_feeder.load("a"),
        lambda: cell.chuck.clamp(),
        lambda: cell.guard.window(0.5),
        lambda: cell.scanner.capture("shaft"),
    ]


async def busy(cell: Cell, rng: np.random.Generator) -> None:
    """Whatever comes to mind, for ever; refusals are no reason to stop."""
    while True:
        work = jobs(cell, rng)
        with contextlib.suppress(CellError):
            await work[int(rng.integers(len(work)))]()
        await asyncio.sleep(0.01)


@pytest.mark.parametrize("seed", range(40))
def test_safe_from_any_instant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    instant_s = READY_S + float(rng.uniform(0.0, 20.0))
    hung = str(rng.choice(list(Devices.model_fields))) if rng.random() < 0.5 else ""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        cell, plant = await built(*([Fault(hung, "hung", at_s=instant_s - 0.01)] if hung else []))
        await cell.guard.arm(GUARD)
        work = [loop.create_task(busy(cell, rng)) for _ in range(6)]
        await asyncio.sleep(instant_s - loop.time())
        report = await cell.make_safe(DEADLINE_S)
        assert loop.time() - instant_s <= DEADLINE_S + 1e-9
        assert set(report.unsafe) == ({hung} if hung else set())
        for name in AXES:
            assert name == hung or not plant.motion[name].moving(loop.time()), f"{name} moves"
        for task in work:
            task.cancel()
        await asyncio.wait(work, timeout=1.0)
        assert all(task.done() for task in work)
        versions = {name: plant.motion[name].version for name in AXES if name != hung}
        await asyncio.sleep(5.0)
        assert versions == {name: plant.motion[name].version for name in versions}
        if not hung:
            assert not (await cell.heater.read()).on
        await cell.close()
        left = [task.get_name() for task in asyncio.all_tasks() if task is not asyncio.current_task()]
        assert not left

    run_virtual(main())


def test_after_a_rearm_nothing_old_goes_on_and_new_motion_is_possible() -> None:
    async def main() -> None:
        cell, plant = await built()
        await cell.guard.arm(GUARD)
        move = asyncio.get_running_loop().create_task(cell.jack.move_to(300.0, speed=10.0))
        await asyncio.sleep(5.0)
        assert (await cell.make_safe(DEADLINE_S)).safe
        with pytest.raises(CellError):
            await move
        height = plant.motion["jack"].position(asyncio.get_running_loop().time())
        await cell.rearm()
        await asyncio.sleep(5.0)
        assert plant.motion["jack"].position(asyncio.get_running_loop().time()) == height > 10.0
        assert (await cell.jack.move_to(0.0, speed=20.0)).position == pytest.approx(0.0, abs=0.02)
        await cell.close()

    run_virtual(main())


def test_the_rules_of_the_envelope_hold_on_the_twin() -> None:
    async def main() -> None:
        cell, plant = await built()
        await cell.camera_park.go("shaft")
        with pytest.raises(DeviceRefused, match="camera"):
            await cell.jack.move_to(100.0, speed=10.0)
        await cell.camera_park.go("parked")
        await cell.jack.move_to(100.0, speed=10.0)
        with pytest.raises(DeviceRefused, match="camera's way"):
            await cell.camera_park.go("rotor")
        with pytest.raises(DeviceRefused, match="guard is not armed"):
            await cell.jack.move_to(380.0, speed=10.0)
        await cell.jack.move_to(0.0, speed=20.0)
        await cell.chuck.release()
        with pytest.raises(DeviceRefused, match="chuck"):
            await cell.stage_x.move_to(1.0, speed=1.0)
        assert plant.damages == []
        await cell.close()

    run_virtual(main())


@pytest.mark.parametrize("kind", ["estop", "guard_open", "sto_open", "channels_disagree"])
def test_the_hard_wired_circuit_stops_the_drives_and_the_software_says_why(kind: str) -> None:
    async def main() -> None:
        cell, plant = await built(Fault("safety", kind, at_s=20.0, duration_s=10.0))
        loop = asyncio.get_running_loop()
        with pytest.raises(SafetyOpen, match=r"emergency stop|guard doors|safe torque off"):
            await cell.jack.move_to(300.0, speed=10.0)
        assert 20.0 <= loop.time() <= 20.3
        await asyncio.sleep(0.5)
        assert not plant.motion["jack"].moving(loop.time())
        with pytest.raises(SafetyOpen):
            await cell.rearm()
        await asyncio.sleep(10.0)
        await cell.make_safe(DEADLINE_S)
        await cell.rearm()
        await cell.jack.move_to(0.0, speed=10.0)
        await cell.close()

    run_virtual(main())
