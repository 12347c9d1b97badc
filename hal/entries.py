"""Entries of the devices in the cell file: one class for each kind of each device."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from hal.interfaces import View
from hal.units import Fraction, Seconds, Watt

BY_KIND = Field(discriminator="kind")
AXIS_UNITS: Mapping[str, Literal["mm", "deg"]] = MappingProxyType(
    {"stage_x": "mm", "stage_y": "mm", "jack": "mm", "shaft_table": "deg", "gun_table": "deg", "gun_feed": "mm"}
)
"""The axes of a cell and what they are measured in."""


class Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _AnyAxis(Section):
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

    @property
    def consumer_s(self) -> float:
        """The drive stops by itself where it hears no heartbeat of the controller for so long."""
        return 2.0 * self.heartbeat_s

    @property
    def silence_s(self) -> float:
        """A drive whose own heartbeat is not heard for so long is lost."""
        return 3.0 * self.heartbeat_s


class CanEntry(Section):
    """`[can]`: the CAN adapter in python-can's own words, and the controller's node number."""

    interface: str
    channel: str
    bitrate: int = Field(default=1_000_000, gt=0)
    node: int = Field(default=127, ge=1, le=127)
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)

    @property
    def described(self) -> dict[str, str | int | float | bool]:
        """The adapter, as python-can takes it."""
        return {"interface": self.interface, "channel": self.channel, "bitrate": self.bitrate, **self.options}


AnyAxisEntry = Annotated[AxisEntry | CanAxisEntry, BY_KIND]


class ForceEntry(Section):
    """A streaming force sensor."""

    kind: Literal["fake"]
    rate_hz: float = Field(default=1000.0, gt=0)
    range_n: float = Field(default=2000.0, gt=0)


class ForceLineEntry(Section):
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


class FileDropEntry(Section):
    """A scanner whose software takes requests from, and leaves its clouds in, a folder of this cell's own."""

    kind: Literal["file_drop"]
    folder: Path
    serial: str = ""
    poll_s: Seconds = Field(default=0.02, gt=0)
    reply_s: Seconds = Field(default=2.0, gt=0)
    frame_s: Seconds = Field(default=10.0, gt=0)


class GentlEntry(Section):
    """A scanner behind a GenTL producer (the path of a .cti file; "socket://HOST:PORT" for a simulated one).

    `serial` names the camera where the producer shows several. With `trigger` "free" the camera gives frames from the
    start of an acquisition on by itself. `user_sets` are the camera's own settings to be loaded for each view. It
    answers within `reply_s`, or is ended; a frame comes within `frame_s`.
    """

    kind: Literal["gentl"]
    producer: str
    serial: str = ""
    trigger: Literal["software", "free"] = "software"
    user_sets: dict[View, str] = Field(default_factory=dict)
    reply_s: Seconds = Field(default=4.0, gt=0)
    frame_s: Seconds = Field(default=10.0, gt=0)


class HeaterEntry(Section):
    """The heater controller."""

    kind: Literal["fake"]
    max_power_w: Watt = Field(default=4000.0, gt=0)


class PlainEntry(Section):
    """A device that needs no numbers of its own."""

    kind: Literal["fake"]


class GunEntry(Section):
    """A tightening gun behind a controller of its own. `serial` is checked where it is given.

    Each maker's entry says where its two ends are made, `backend(name, entry)` and `simulator(name, entry, plant,
    faults, programs)`: what composes a cell knows no maker.
    """

    backend: ClassVar[str]
    simulator: ClassVar[str]
    host: str
    port: int = Field(ge=1, le=65535)
    serial: str = ""


class OpenProtocolEntry(GunEntry):
    """A tightening gun behind an Open Protocol controller, whose serial number is meant.

    `start_input` and `running_relay` are the controller's functions "remote start" and "tool running"; `estop_alarms`
    are the codes of its alarms that mean that the hard-wired circuit took its power; `trace_order` is the byte order
    of its curves.
    """

    backend: ClassVar[str] = "hal.real.gun:OpenProtocolGun"
    simulator: ClassVar[str] = "hal.fake.wire.gun:GunController.of"
    kind: Literal["open_protocol"]
    port: int = Field(default=4545, ge=1, le=65535)
    start_input: int = Field(default=7, ge=0, le=999)
    running_relay: int = Field(default=26, ge=1, le=999)
    estop_alarms: tuple[str, ...] = ()
    trace_order: Literal["big", "little"] = "big"


class KducerEntry(GunEntry):
    """A tightening gun behind a Kolver K-Ducer on Modbus TCP. `serial` is the screwdriver's.

    The controller's first `programs` programs are this cell's. It lets go of the lever, and stops, where the lever is
    not set again in time: `lever_s` must be below that time, which is measured at commissioning.
    """

    backend: ClassVar[str] = "hal.real.kducer:KducerGun"
    simulator: ClassVar[str] = "hal.fake.wire.kducer:KducerController"
    kind: Literal["kducer"]
    port: int = Field(default=502, ge=1, le=65535)
    unit: int = Field(default=1, ge=1, le=247)
    programs: int = Field(default=16, ge=1, le=64)
    lever_s: Seconds = Field(default=0.2, ge=0.1, le=1.0)
    deadline_s: Seconds = Field(default=1.5, gt=0)


class ModbusEntry(Section):
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


class ModbusEnableEntry(ModbusEntry):
    """The output that lets the guns turn, at a coupler that drops it after `watchdog_s` of silence."""

    watchdog_s: Seconds = Field(default=1.0, ge=0.1, le=10.0)


class ModbusStationEntry(ModbusEntry):
    """The part station; presenting takes no longer than `present_s`."""

    present_s: Seconds = Field(default=120.0, gt=0)


class Devices(Section):
    """`[devices.NAME]`: every device of the cell, by its name everywhere else."""

    stage_x: AnyAxisEntry
    stage_y: AnyAxisEntry
    jack: AnyAxisEntry
    shaft_table: AnyAxisEntry
    gun_table: AnyAxisEntry
    gun_feed: AnyAxisEntry
    gun_a: Annotated[PlainEntry | OpenProtocolEntry | KducerEntry, BY_KIND]
    gun_b: Annotated[PlainEntry | OpenProtocolEntry | KducerEntry, BY_KIND]
    jack_force: Annotated[ForceEntry | ForceLineEntry, BY_KIND]
    gun_force_a: Annotated[ForceEntry | ForceLineEntry, BY_KIND]
    gun_force_b: Annotated[ForceEntry | ForceLineEntry, BY_KIND]
    spigot_tc_1: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    spigot_tc_2: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    pyrometer: Annotated[PlainEntry | ModbusPyrometerEntry, BY_KIND]
    rotor_tc: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    heater: Annotated[HeaterEntry | ModbusHeaterEntry, BY_KIND]
    chuck: Annotated[PlainEntry | ModbusStrokeEntry, BY_KIND]
    camera_park: Annotated[PlainEntry | ModbusStrokeEntry, BY_KIND]
    nut_feeder: Annotated[PlainEntry | ModbusStrokeEntry, BY_KIND]
    tool_enable: Annotated[PlainEntry | ModbusEnableEntry, BY_KIND]
    gap_probe_1: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    gap_probe_2: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    gap_probe_3: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    safety: Annotated[PlainEntry | ModbusEntry, BY_KIND]
    part_station: Annotated[PlainEntry | ModbusStationEntry, BY_KIND]
    scanner: Annotated[PlainEntry | FileDropEntry | GentlEntry, BY_KIND]
