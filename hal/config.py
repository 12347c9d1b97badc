"""The cell file (TOML): one entry per device chosen by `kind`, guard, calibration, auth and, for fakes, the twin.

Unknown keys are refused; every fault is reported with its place.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal.errors import ConfigError
from hal.units import Bar, Fraction, Kilogram, Mm, NewtonPerMm, Seconds, Watt

Level = Literal["ideal", "nominal", "hostile"]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _AnyAxis(_Section):
    """One axis. Travel in its unit (mm or deg), speed per second; a motion has arrived within `in_position`."""

    low: float
    high: float
    max_speed: float = Field(gt=0)
    max_acceleration: float = Field(gt=0)
    in_position: float = Field(default=0.02, gt=0)

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low >= self.high:
            raise ValueError(f"low {self.low} must lie below high {self.high}")
        return self


class AxisEntry(_AnyAxis):
    """A simulated axis."""

    kind: Literal["fake"]


class CanAxisEntry(_AnyAxis):
    """A drive on the CAN bus of `[can]` (CiA 402). Scale, gear and feed must be what the drive itself says.

    The drive's position unit is 1/`counts_per_unit` mm or deg; `feed` is in those, per `feed_shaft` revolutions.
    `referenced_bit` of the statusword says that the reference is valid; `standstill` is per second. `homing_method`
    is the drive's (0x6098); `brake`: the drive closes a holding brake and says so (0x60FE). Identity numbers that are
    given must be met.
    """

    kind: Literal["canopen"]
    node: int = Field(ge=1, le=126)
    counts_per_unit: float = Field(default=10_000.0, gt=0)
    encoder_increments: int = Field(gt=0)
    encoder_revolutions: int = Field(default=1, gt=0)
    gear_motor: int = Field(default=1, gt=0)
    gear_shaft: int = Field(default=1, gt=0)
    feed: int = Field(gt=0)
    feed_shaft: int = Field(default=1, gt=0)
    homing_method: int = Field(ge=-128, le=37)
    homing_share: Fraction = Field(default=0.5, gt=0, le=1)
    brake: bool = True
    referenced_bit: Literal[8, 14, 15] = 15
    following_error: float = Field(default=1.0, gt=0)
    standstill: float = Field(default=0.01, gt=0)
    ramp_s: Seconds = Field(default=0.1, gt=0)
    quick_stop_factor: float = Field(default=4.0, ge=1)
    heartbeat_s: Seconds = Field(default=0.1, ge=0.01)
    pdo_s: Seconds = Field(default=0.01, ge=0.001)
    reply_s: Seconds = Field(default=2.0, gt=0)
    vendor: int | None = None
    product: int | None = None
    serial: int | None = None


class CanEntry(_Section):
    """`[can]`: the CAN adapter in python-can's own words, and the controller's node number."""

    interface: str
    channel: str
    bitrate: int = Field(default=1_000_000, gt=0)
    node: int = Field(default=127, ge=1, le=127)
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)


AnyAxisEntry = Annotated[AxisEntry | CanAxisEntry, Field(discriminator="kind")]


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

    stage_x: AnyAxisEntry
    stage_y: AnyAxisEntry
    jack: AnyAxisEntry
    shaft_table: AnyAxisEntry
    gun_table: AnyAxisEntry
    gun_feed: AnyAxisEntry
    gun_a: Annotated[PlainEntry | OpenProtocolEntry, Field(discriminator="kind")]
    gun_b: Annotated[PlainEntry | OpenProtocolEntry, Field(discriminator="kind")]
    jack_force: ForceEntry
    gun_force_a: ForceEntry
    gun_force_b: ForceEntry
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
    can: CanEntry | None = None
    path: Path = Field(default=Path(), exclude=True)

    @model_validator(mode="after")
    def _nodes(self) -> Self:
        axes = {
            name: entry.node
            for name in Devices.model_fields
            if isinstance(entry := getattr(self.devices, name), CanAxisEntry)
        }
        if axes and self.can is None:
            raise ValueError(f"{', '.join(axes)}: on CAN, but there is no [can]")
        taken = [*axes.values(), self.can.node] if self.can else []
        if len(set(taken)) < len(taken):
            raise ValueError(f"CAN node numbers {sorted(taken)} must differ")
        return self

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
