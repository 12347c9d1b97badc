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


class ForceLineEntry(_Section):
    """A force amplifier that streams lines over the serial port `path`; rate and range must be what it says itself.

    `serial` is the amplifier's, checked where it is given. It answers within `reply_s`; a stream that brings nothing
    for `silence_s` has ended.
    """

    kind: Literal["force_line"]
    path: str
    baud: int = Field(default=460_800, ge=9600)
    rate_hz: float = Field(default=1000.0, gt=0)
    range_n: float = Field(default=2000.0, gt=0)
    serial: str = ""
    reply_s: Seconds = Field(default=2.0, gt=0)
    silence_s: Seconds = Field(default=2.0, gt=0)


class FileDropEntry(_Section):
    """A scanner whose software takes requests from, and leaves its clouds in, a folder of this cell's own."""

    kind: Literal["file_drop"]
    folder: Path
    serial: str = ""
    poll_s: Seconds = Field(default=0.02, gt=0)
    reply_s: Seconds = Field(default=2.0, gt=0)
    frame_s: Seconds = Field(default=10.0, gt=0)


class HeaterEntry(_Section):
    """The heater controller."""

    kind: Literal["fake"]
    max_power_w: Watt = Field(default=4000.0, gt=0)


class PlainEntry(_Section):
    """A device that needs no numbers of its own."""

    kind: Literal["fake"]


class OpenProtocolEntry(_Section):
    """A tightening gun behind an Open Protocol controller.

    `serial` is the controller's, checked where it is given. `start_input` and `running_relay` are the controller's
    functions "remote start" and "tool running"; `estop_alarms` are the codes of its alarms that mean that the
    hard-wired circuit took its power; `trace_order` is the byte order of its curves.
    """

    kind: Literal["open_protocol"]
    host: str
    port: int = Field(default=4545, ge=1, le=65535)
    serial: str = ""
    start_input: int = Field(default=7, ge=0, le=999)
    running_relay: int = Field(default=26, ge=1, le=999)
    estop_alarms: tuple[str, ...] = ()
    trace_order: Literal["big", "little"] = "big"


class Devices(_Section):
    """`[devices.NAME]`: every device of the cell, by its name everywhere else."""

    stage_x: AxisEntry
    stage_y: AxisEntry
    jack: AxisEntry
    shaft_table: AxisEntry
    gun_table: AxisEntry
    gun_feed: AxisEntry
    gun_a: Annotated[PlainEntry | OpenProtocolEntry, Field(discriminator="kind")]
    gun_b: Annotated[PlainEntry | OpenProtocolEntry, Field(discriminator="kind")]
    jack_force: Annotated[ForceEntry | ForceLineEntry, Field(discriminator="kind")]
    gun_force_a: Annotated[ForceEntry | ForceLineEntry, Field(discriminator="kind")]
    gun_force_b: Annotated[ForceEntry | ForceLineEntry, Field(discriminator="kind")]
    spigot_tc_1: PlainEntry
    spigot_tc_2: PlainEntry
    pyrometer: PlainEntry
    rotor_tc: PlainEntry
    heater: HeaterEntry
    chuck: PlainEntry
    camera_park: PlainEntry
    nut_feeder: PlainEntry
    gap_probe_1: PlainEntry
    gap_probe_2: PlainEntry
    gap_probe_3: PlainEntry
    safety: PlainEntry
    part_station: PlainEntry
    scanner: Annotated[PlainEntry | FileDropEntry, Field(discriminator="kind")]


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
