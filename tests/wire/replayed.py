"""What was done with a device while its bus was recorded for the replays, and is done again against the replay.

The recordings in `tests/wire/captures` were made by the command, with `cellctl simulate --cell deploy/cell.wire.toml
--recipe recipes/lpt_shaft_36.toml` beside it, each while this module did its part in another process:

    cellctl capture gun_a --cell deploy/cell.wire.toml -o gun.jsonl --listen 45450
    python -m tests.wire.replayed gun 45450

likewise `heater` at a port, `gun_force_a` at a path, and `can`, which is listened to, at the port of the hub.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Awaitable, Callable, Mapping

from hal.bus.can import CanBus
from hal.bus.modbus import Lines
from hal.entries import CanAxisEntry, ForceLineEntry, ModbusHeaterEntry, OpenProtocolEntry
from hal.interfaces import AxisState, ForceBlock, HeaterState, TighteningProgram, TighteningResult
from hal.real.axes import CanAxis
from hal.real.force import SerialForceSensor
from hal.real.gun import OpenProtocolGun
from hal.real.modbus_devices import modbus_device

STAGE_X = CanAxisEntry(
    kind="canopen",
    node=1,
    low=-15.0,
    high=15.0,
    max_speed=5.0,
    max_acceleration=20.0,
    encoder_increments=10_000,
    feed=100_000,
    homing_method=19,
    pdo_s=0.1,
    heartbeat_s=0.5,
)
SNUG = TighteningProgram(
    stage="snug",
    target_torque_nm=10.0,
    torque_low_nm=9.0,
    torque_high_nm=11.0,
    angle_low_deg=0.0,
    angle_high_deg=720.0,
    threshold_torque_nm=6.0,
    speed_rpm=60.0,
    timeout_s=30.0,
)
"""Like the entries here: what the devices were set to then, whatever the example files say."""
BEAT_S = 0.2


async def gun(where: str, program: TighteningProgram = SNUG) -> TighteningResult:
    """One tightening with its curves; the key is fixed, as everything that the controller says."""
    entry = OpenProtocolEntry(kind="open_protocol", host="127.0.0.1", port=int(where), estop_alarms=("E504",))
    device = OpenProtocolGun("gun_a", entry)
    try:
        await device.connect()
        result = await device.tighten("capture-1", program)
        assert await device.result("capture-1") is not None
        assert (await device.safe()).safe
        return result
    finally:
        await device.close()


async def heater(where: str) -> HeaterState:
    """Heat a little and switch off."""
    entry = ModbusHeaterEntry(kind="modbus", port=int(where), unit=1, max_power_w=4000.0, watchdog_s=5.0)
    device = modbus_device("heater", entry, Lines())
    try:
        await device.connect()
        await device.rearm()
        state = await device.heat(30.0, ramp_k_per_min=10.0, max_power_w=500.0)
        await device.halt()
        assert (await device.safe()).safe
        assert isinstance(state, HeaterState)
        return state
    finally:
        await device.close()


async def force(where: str) -> ForceBlock:
    """A quarter of a second of samples."""
    entry = ForceLineEntry(kind="force_line", path=where, rate_hz=100.0, range_n=200.0)
    device = SerialForceSensor("gun_force_a", entry)
    try:
        await device.connect()
        return await device.block(25)
    finally:
        await device.close()


async def axis(where: str, target: float = 0.5) -> AxisState:
    """Out of whatever stop it was in, home, half a millimetre."""
    options = {"channel": f"socket://127.0.0.1:{where}", "bitrate": 1_000_000, "sleep_after_open": 0.0}
    bus = CanBus({"interface": "slcan", **options})
    device = CanAxis("stage_x", "mm", STAGE_X, bus)
    beats = asyncio.create_task(_beat(bus), name="beats")
    try:
        await device.connect()
        await device.rearm()
        await device.home()
        state = await device.move_to(target, speed=2.0)
        assert (await device.safe()).safe
        return state
    finally:
        await device.close()
        beats.cancel()
        await asyncio.gather(beats, return_exceptions=True)


async def _beat(bus: CanBus) -> None:
    while True:
        bus.beat()
        await asyncio.sleep(BEAT_S)


DONE: Mapping[str, Callable[[str], Awaitable[object]]] = {"gun": gun, "heater": heater, "force": force, "axis": axis}

if __name__ == "__main__":

    async def main() -> None:
        print(await DONE[sys.argv[1]](sys.argv[2]))

    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main())
