"""A closed joint on the bench with both guns, for tests: studs in, faces together, chuck clamped."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from hal.fake.devices.gun_force import FakeGunForce
from hal.fake.devices.guns import FakeGun, install_joints
from hal.fake.devices.heating import install_heat
from hal.fake.faults import FaultBook
from hal.fake.geometry import JointGeometry
from hal.fake.joints.state import Joints
from hal.fake.motion import standing
from hal.fake.plant import Plant, TwinSettings
from hal.interfaces import TighteningProgram

GEOMETRY = JointGeometry(angles_deg=tuple(10.0 * i for i in range(36)))
ALIGNED = {
    "chuck_eccentricity_mm": 0.0,
    "chuck_clocking_deg": 0.0,
    "chuck_tilt_deg": 0.0,
    "rotor_eccentricity_mm": 0.0,
    "rotor_clocking_deg": 0.0,
}
OPEN_FIT = ALIGNED | {"fit_interference_mm": -0.02, "sigma_fit_interference_mm": 0.0}
TIP_MM, EDGE_MM, BARE_MM = 89.6, 100.0, 109.6


def program(stage: str, torque_nm: float, speed_rpm: float, **changes: object) -> TighteningProgram:
    """A stage as the recipes have it: 10 % either side, angle from 6 N m on."""
    values: dict[str, object] = {
        "stage": stage,
        "target_torque_nm": torque_nm,
        "torque_low_nm": 0.9 * torque_nm,
        "torque_high_nm": 1.1 * torque_nm,
        "angle_low_deg": 0.0,
        "angle_high_deg": 120.0,
        "threshold_torque_nm": 6.0,
        "speed_rpm": speed_rpm,
        "timeout_s": 30.0,
    }
    return TighteningProgram(**(values | changes))  # type: ignore[arg-type]


SNUG, HALF, FINAL = program("snug", 10.0, 60.0), program("half", 18.0, 20.0), program("final", 36.0, 10.0)
VERIFY = program("verify", 32.4, 10.0, angle_high_deg=10.0)


@dataclass(frozen=True, slots=True)
class Bench:
    """Plant and devices. Everything is connected."""

    plant: Plant
    joints: Joints
    faults: FaultBook
    gun_a: FakeGun
    gun_b: FakeGun
    force_a: FakeGunForce
    force_b: FakeGunForce

    async def move(self, axis: str, target: float, speed: float = 60.0) -> None:
        """Move one axis and wait until it stands."""
        now = asyncio.get_running_loop().time()
        way = self.plant.start_move(axis, target, speed=speed, acceleration=400.0, now=now)
        await asyncio.sleep(max(way.end_s - now, 0.0))

    def gun(self, name: Literal["a", "b"]) -> FakeGun:
        """Gun by its letter."""
        return self.gun_a if name == "a" else self.gun_b

    async def start_pair(self, table_deg: float) -> None:
        """Fresh nuts on the two joints at `table_deg` and opposite, two turns deep, guns left in place."""
        await self.move("gun_feed", 0.0)
        await self.move("gun_table", table_deg)
        for name in ("a", "b"):
            self.joints.load_nut(name)
        await self.move("gun_feed", TIP_MM + 1.5)
        for gun in (self.gun_a, self.gun_b):
            await gun.turn(-30.0, speed_rpm=10.0, torque_limit_nm=6.0)
            await gun.turn(720.0, speed_rpm=60.0, torque_limit_nm=6.0)

    async def engage_pair(self, table_deg: float) -> None:
        """Sockets over the hexes of nuts that are tight."""
        await self.move("gun_feed", 0.0)
        await self.move("gun_table", table_deg)
        await self.move("gun_feed", EDGE_MM + 1.5)
        for gun in (self.gun_a, self.gun_b):
            for _ in range(3):
                met = await gun.turn(20.0, speed_rpm=10.0, torque_limit_nm=6.0)
                if met.peak_torque_nm >= 5.9:
                    break
            else:
                raise AssertionError("the socket did not drop")


async def closed_joint(
    *, seed: int = 1, level: str = "nominal", faults: FaultBook | None = None, overrides: Mapping[str, float] = OPEN_FIT
) -> Bench:
    """The bench, its devices connected. Must be awaited inside the loop that runs the test."""
    plant = Plant(GEOMETRY, TwinSettings(seed=seed, level=level, overrides=overrides))  # type: ignore[arg-type]
    install_heat(plant)
    joints = install_joints(plant)
    plant.motion["jack"].start(standing(plant.bench.rotor_face_mm + 0.3, 0.0), 0.0)
    plant.set_chuck(clamped=True)
    book = faults or FaultBook()
    bench = Bench(
        plant,
        joints,
        book,
        FakeGun("gun_a", plant, book),
        FakeGun("gun_b", plant, book),
        FakeGunForce("gun_force_a", plant, book, 100.0, 200.0),
        FakeGunForce("gun_force_b", plant, book, 100.0, 200.0),
    )
    for device in (bench.gun_a, bench.gun_b, bench.force_a, bench.force_b):
        await device.connect()
    return bench
