"""The cell file (TOML): one entry per device chosen by `kind`, guard, calibration, auth and, for fakes, the twin.

Unknown keys are refused; every fault is reported with its place.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self, get_args

from pydantic import Field, ValidationError, model_validator

from hal.entries import CanAxisEntry, CanEntry, Devices, ForceLineEntry, ModbusEnableEntry, Section
from hal.errors import ConfigError
from hal.units import Bar, Fraction, Kilogram, Mm, NewtonPerMm, Seconds

Level = Literal["ideal", "nominal", "hostile"]


class Delays(Section):
    """`[guard]`: the chain of delays from a force to a standing jack, and what the guard takes for a dead sensor.

    Samples older than `stale_ms` are stale; `frozen_samples` equal ones in a row are frozen (0: never). `process` says
    where the guard runs: in the controller's loop, as a child of the controller, or as a service that the system
    starts. A guard of its own owns CAN adapter and jack force, is reached at `socket` (relative to the cell file; a
    folder in memory, as /run is, keeps the ring of samples beside it off the disk), and takes a controller that it does
    not hear for `beat_ms`, or for `quiet_ms` while it is not armed, for dead.
    """

    process: Literal["in_loop", "child", "service"] = "in_loop"
    socket: Path = Path("guard.sock")
    beat_ms: float = Field(default=100.0, ge=10)
    quiet_ms: float = Field(default=500.0, ge=10)

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


class Envelope(Section):
    """`[envelope]`: heights and pressures by which the motion rules (hal.permits) judge.

    The camera may stand in a view while the jack is at or below `view_safe_mm`; stage and shaft table move, and the
    jack rises unguarded, only at or below `free_mm`; the guns are back while their feed is at or below `guns_back_mm`.
    What the rules look at and has not answered within `read_s` is unknown, and nothing moves.
    """

    view_safe_mm: Mm = 20.0
    free_mm: Mm = 360.0
    guns_back_mm: Mm = 1.0
    chuck_pressure_low_bar: Bar = Field(default=4.0, ge=0)
    read_s: Seconds = Field(default=0.25, gt=0, le=2.0)


class CalibrationEntry(Section):
    """`[calibration]`: where the controller's belief lies, relative to the cell file."""

    file: Path


class Auth(Section):
    """`[auth]`: demo is accepted only on a loopback host with devices that are simulated; keys names a file of keys."""

    mode: Literal["demo", "keys"] = "demo"
    keys: Path | None = None

    @model_validator(mode="after")
    def _whole(self) -> Auth:
        if (self.mode == "keys") != (self.keys is not None):
            raise ValueError('keys names a file of keys where mode = "keys", and only there')
        return self


class Twin(Section):
    """`[twin]`: the plant behind fake devices. Overrides replace one imperfection or property by name."""

    seed: int = Field(default=1, ge=0)
    level: Level = "nominal"
    points: int = Field(default=500_000, ge=10_000, le=5_000_000)
    overrides: dict[str, float] = Field(default_factory=dict)


class CellSection(Section):
    """`[cell]`: the cell as a whole."""

    name: str
    rotor_face_mm: Mm = 400.0
    safe_deadline_s: Seconds = Field(default=0.5, gt=0)
    moving_mass_kg: Kilogram = Field(default=100.0, gt=0)
    jack_stiffness_n_per_mm: NewtonPerMm = Field(default=1350.0, gt=0)
    weight_tolerance: Fraction = Field(default=0.05, gt=0)


class CellConfig(Section):
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
    def _guarded(self) -> Self:
        if self.guard.process != "in_loop" and not (self.can and isinstance(self.devices.jack_force, ForceLineEntry)):
            raise ValueError("a guard process owns the CAN adapter and the jack's force sensor on a serial port")
        return self

    @model_validator(mode="after")
    def _enabled(self) -> Self:
        """A serial line has one owner."""
        enable = self.devices.tool_enable
        path = enable.port_path if isinstance(enable, ModbusEnableEntry) else ""
        shared = [name for name, one in self.entries.items() if path and getattr(one, "port_path", "") == path]
        if self.guard.process != "in_loop" and len(shared) > 1:
            raise ValueError(f"{path} of {', '.join(shared)}: a guard process has the tool enable on a line of its own")
        return self

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
        return self.beside(self.calibration.file)

    def beside(self, file: Path | str) -> Path:
        """A path of the cell file, resolved against its folder."""
        return self.path.parent / file

    @property
    def keys_path(self) -> Path:
        """The file of keys. Raises ConfigError where the cell's sign-in is another."""
        if self.auth.keys is None:
            raise ConfigError('the sign-in of this cell is not by keys: mode = "keys"', place="auth.mode")
        return self.beside(self.auth.keys)

    @property
    def entries(self) -> Mapping[str, Any]:
        """The entry of every device by its name, in the order of the cell file."""
        return MappingProxyType({name: getattr(self.devices, name) for name in Devices.model_fields})

    @property
    def consumer_s(self) -> float:
        """The first of the drives stops by itself after so long without a heartbeat."""
        drives = (entry for entry in self.entries.values() if isinstance(entry, CanAxisEntry))
        return min((drive.consumer_s for drive in drives), default=0.2)

    @property
    def kinds(self) -> Mapping[str, str]:
        """The kind of every device."""
        return MappingProxyType({name: entry.kind for name, entry in self.entries.items()})

    def on_fakes(self) -> CellConfig:
        """The same cell with a fake for every device, with the numbers that the real one has."""
        told = {
            name: {key: value for key, value in entry.model_dump().items() if key in FAKE_FIELDS[name]}
            for name, entry in self.entries.items()
        }
        fakes = {name: numbers | {"kind": "fake"} for name, numbers in told.items()}
        guard = self.guard.model_copy(update={"process": "in_loop"})
        return self.model_copy(update={"devices": Devices.model_validate(fakes), "guard": guard})


def _fake_fields(name: str) -> frozenset[str]:
    kinds = get_args(Devices.model_fields[name].annotation)
    fake = next(kind for kind in kinds if get_args(kind.model_fields["kind"].annotation) == ("fake",))
    return frozenset(fake.model_fields)


FAKE_FIELDS: Mapping[str, frozenset[str]] = MappingProxyType(
    {name: _fake_fields(name) for name in Devices.model_fields}
)
"""The keys that a fake of each device has in the cell file."""


def without_kind(loc: tuple[int | str, ...]) -> tuple[int | str, ...]:
    """The place of a fault in the cell file: the kind that an entry was read as is no key of it."""
    return loc[:2] + loc[3:] if loc[:1] == ("devices",) and len(loc) > 2 else loc


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
        place = ".".join([path.name, *map(str, without_kind(first["loc"]))])
        raise ConfigError(first["msg"], place=place) from None
