"""The cell file (TOML): one entry per device chosen by `kind`, guard, calibration, auth and, for fakes, the twin.

Unknown keys are refused; every fault is reported with its place.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal.errors import ConfigError
from hal.units import Bar, Fraction, Kilogram, Mm, NewtonPerMm, Seconds, Watt

Level = Literal["ideal", "nominal", "hostile"]
_BY_KIND = Field(discriminator="kind")


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class AxisEntry(_Section):
    """One axis. Travel in its unit (mm or deg), speed per second; a motion has arrived within `in_position`."""

    kind: Literal["fake"]
    low: float
    high: float
    max_speed: float = Field(gt=0)
    max_acceleration: float = Field(gt=0)
    in_position: float = Field(default=0.02, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> AxisEntry:
        if self.low >= self.high:
            raise ValueError(f"low {self.low} must lie below high {self.high}")
        return self


class ForceEntry(_Section):
    """A streaming force sensor."""

    kind: Literal["fake"]
    rate_hz: float = Field(default=1000.0, gt=0)
    range_n: float = Field(default=2000.0, gt=0)


class HeaterEntry(_Section):
    """The heater controller."""

    kind: Literal["fake"]
    max_power_w: Watt = Field(default=4000.0, gt=0)


class PlainEntry(_Section):
    """A device that needs no numbers of its own."""

    kind: Literal["fake"]


class ModbusEntry(_Section):
    """A device behind a Modbus server (`host`, `port`) or on a serial line (`port_path`, framing rtu).

    `base` is its first register there. A unit that says another serial number than `serial` is not the one meant.
    """

    kind: Literal["modbus"]
    host: str = "127.0.0.1"
    port: int = Field(default=502, ge=1, le=65535)
    framing: Literal["tcp", "rtu"] = "tcp"
    port_path: str = ""
    baud: int = Field(default=19200, ge=1200)
    parity: Literal["N", "E", "O"] = "E"
    deadline_s: Seconds = Field(default=1.5, gt=0)
    worst_reply_s: Seconds = Field(default=2.0, gt=0)
    unit: int = Field(default=1, ge=1, le=247)
    base: int = Field(default=0, ge=0, le=0xFFF)
    serial: str = ""


class ModbusPyrometerEntry(ModbusEntry):
    """A pyrometer whose set emissivity is read back and compared."""

    emissivity: Fraction = Field(default=0.95, ge=0.05, le=1.1)


class ModbusHeaterEntry(ModbusEntry):
    """The heater controller; it goes off-line where it hears nothing for `watchdog_s`."""

    max_power_w: Watt = Field(default=4000.0, gt=0)
    watchdog_s: Seconds = Field(default=5.0, ge=1.0, le=60.0)


class ModbusStrokeEntry(ModbusEntry):
    """Something moved by outputs of a coupler that drops them after `watchdog_s` of silence. A motion that takes
    longer than `stroke_s` has failed."""

    watchdog_s: Seconds = Field(default=1.0, ge=0.1, le=10.0)
    stroke_s: Seconds = Field(default=8.0, gt=0)


class ModbusStationEntry(ModbusEntry):
    """The part station; presenting takes no longer than `present_s`."""

    present_s: Seconds = Field(default=120.0, gt=0)


class Devices(_Section):
    """`[devices.NAME]`: every device of the cell, by its name everywhere else."""

    stage_x: AxisEntry
    stage_y: AxisEntry
    jack: AxisEntry
    shaft_table: AxisEntry
    gun_table: AxisEntry
    gun_feed: AxisEntry
    gun_a: PlainEntry
    gun_b: PlainEntry
    jack_force: ForceEntry
    gun_force_a: ForceEntry
    gun_force_b: ForceEntry
    spigot_tc_1: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    spigot_tc_2: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    pyrometer: Annotated[PlainEntry | ModbusPyrometerEntry, _BY_KIND]
    rotor_tc: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    heater: Annotated[HeaterEntry | ModbusHeaterEntry, _BY_KIND]
    chuck: Annotated[PlainEntry | ModbusStrokeEntry, _BY_KIND]
    camera_park: Annotated[PlainEntry | ModbusStrokeEntry, _BY_KIND]
    nut_feeder: Annotated[PlainEntry | ModbusStrokeEntry, _BY_KIND]
    gap_probe_1: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    gap_probe_2: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    gap_probe_3: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    safety: Annotated[PlainEntry | ModbusEntry, _BY_KIND]
    part_station: Annotated[PlainEntry | ModbusStationEntry, _BY_KIND]
    scanner: PlainEntry


class Delays(_Section):
    """`[guard]`: the chain of delays from a force to a standing jack, and what the guard takes for a dead sensor.

    Samples older than `stale_ms` are stale; `frozen_samples` equal ones in a row are frozen (0: never).
    """

    stale_ms: float = Field(default=50.0, ge=5)
    sensor_s: Seconds = Field(default=0.002, ge=0)
    guard_s: Seconds = Field(default=0.002, ge=0)
    bus_s: Seconds = Field(default=0.001, ge=0)
    drive_s: Seconds = Field(default=0.004, ge=0)
    frozen_samples: int = Field(default=200, ge=0)
    contact_block: int = Field(default=10, ge=1)
    idle_block: int = Field(default=500, ge=1)
    noise_n: float = Field(default=0.1, ge=0)
    tare_n: float = Field(default=0.3, ge=0)


class Envelope(_Section):
    """`[envelope]`: heights and pressures by which the motion rules (hal.permits) judge.

    The camera may stand in a view while the jack is at or below `view_safe_mm`; stage and shaft table move, and the
    jack rises unguarded, only at or below `free_mm`; the guns are back while their feed is at or below `guns_back_mm`.
    """

    view_safe_mm: Mm = 20.0
    free_mm: Mm = 360.0
    guns_back_mm: Mm = 1.0
    chuck_pressure_low_bar: Bar = Field(default=4.0, ge=0)


class CalibrationEntry(_Section):
    """`[calibration]`: where the controller's belief lies, relative to the cell file."""

    file: Path


class Auth(_Section):
    """`[auth]`: demo is accepted only on a loopback host with fake devices."""

    mode: Literal["demo"] = "demo"


class Twin(_Section):
    """`[twin]`: the plant behind fake devices. Overrides replace one imperfection or property by name."""

    seed: int = Field(default=1, ge=0)
    level: Level = "nominal"
    points: int = Field(default=500_000, ge=10_000, le=5_000_000)
    overrides: dict[str, float] = Field(default_factory=dict)


class CellSection(_Section):
    """`[cell]`: the cell as a whole."""

    name: str
    rotor_face_mm: Mm = 400.0
    safe_deadline_s: Seconds = Field(default=0.5, gt=0)
    moving_mass_kg: Kilogram = Field(default=100.0, gt=0)
    jack_stiffness_n_per_mm: NewtonPerMm = Field(default=1350.0, gt=0)
    weight_tolerance: Fraction = Field(default=0.05, gt=0)


class CellConfig(_Section):
    """One cell file. `path` is where it was read from, for files named relative to it."""

    cell: CellSection
    devices: Devices
    guard: Delays = Delays()
    envelope: Envelope = Envelope()
    calibration: CalibrationEntry
    auth: Auth = Auth()
    twin: Twin = Twin()
    path: Path = Field(default=Path(), exclude=True)

    @property
    def calibration_path(self) -> Path:
        """The calibration file, resolved against the cell file's folder."""
        return self.path.parent / self.calibration.file


def load_cell(path: Path) -> CellConfig:
    """Cell file from TOML. Raises ConfigError with place and reason."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", place=str(path)) from None
    try:
        return CellConfig.model_validate(data | {"path": path})
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([path.name, *(str(part) for part in first["loc"])])
        raise ConfigError(first["msg"], place=place) from None
