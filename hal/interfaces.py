"""One Protocol per kind of device, and the readings they give.

Rules that hold for every device, fake or real:

* ``connect`` proves the identity of the device; ``close`` never raises.
* ``halt`` stops what the device is doing and returns only when the device has acknowledged it. It has no
  default: a device that cannot be stopped says so by raising.
* ``safe`` reads back whether the device is in its safe state; it never assumes.
* ``rearm`` makes every set-point the measured value, so that an old target is never resumed.
* A command returns when the device reports it done, with what was read back. It raises a `hal.errors.DeviceError`
  otherwise. Every exchange has a deadline of its own inside the backend.
* Times (``time_s``) are the event loop's monotonic seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

View = Literal["rotor", "shaft", "artefact_rotor", "artefact_shaft"]
"""What the camera looks at. The two ``artefact_*`` views use the camera poses of ``rotor`` (looking up) and
``shaft`` (looking down) on the two-sided sphere artefact that is fixed to the bench."""


class Quality(StrEnum):
    """Whether a reading may be used."""

    GOOD = "good"
    UNCERTAIN = "uncertain"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class Identity:
    """Who a device says it is. `simulated` is true for every fake and simulator."""

    vendor: str
    model: str
    serial: str
    firmware: str
    simulated: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """One value in the unit that the device's interface states."""

    value: float
    time_s: float
    quality: Quality = Quality.GOOD


@dataclass(frozen=True, slots=True)
class SafeState:
    """Read-back of the safe state; `detail` is one sentence for the operator."""

    safe: bool
    detail: str


class Device(Protocol):
    """What every device can do."""

    @property
    def name(self) -> str: ...
    async def connect(self) -> Identity: ...
    async def close(self) -> None: ...
    async def halt(self) -> None: ...
    async def safe(self) -> SafeState: ...
    async def rearm(self) -> None: ...


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Travel, speed and acceleration limits in the axis' unit (mm or deg), per second."""

    low: float
    high: float
    max_speed: float
    max_acceleration: float


@dataclass(frozen=True, slots=True)
class AxisState:
    """Read-back of an axis: encoder position in mm or deg, velocity per second, and the drive's own flags."""

    position: float
    velocity: float
    homed: bool
    enabled: bool
    brake_closed: bool
    moving: bool
    time_s: float


class Axis(Device, Protocol):
    """A positioning axis (CiA 402 profile position). Positions are absolute, in `unit`."""

    @property
    def unit(self) -> Literal["mm", "deg"]: ...
    @property
    def limits(self) -> AxisLimits: ...
    async def home(self) -> AxisState: ...
    async def read(self) -> AxisState: ...
    async def move_to(self, position: float, *, speed: float) -> AxisState:
        """Move to `position` at no more than `speed`; return what the encoder reads once the axis stands.

        Raises DeviceRefused (not homed, outside limits), Interrupted (halted on the way), DeviceFault.
        """
        ...


class Band(StrEnum):
    """Where a value lies against its window."""

    LOW = "low"
    OK = "ok"
    HIGH = "high"


@dataclass(frozen=True, slots=True)
class TighteningProgram:
    """What a gun is asked to do to one joint. Angles in degrees from the threshold torque on; torques in N m."""

    stage: str
    target_torque_nm: float
    torque_low_nm: float
    torque_high_nm: float
    angle_low_deg: float
    angle_high_deg: float
    threshold_torque_nm: float
    speed_rpm: float
    timeout_s: float
    direction: Literal["tighten", "loosen"] = "tighten"


@dataclass(frozen=True, slots=True)
class Trace:
    """Torque over angle over time, equal lengths (n,), time from 0."""

    time_s: NDArray[np.float64]
    angle_deg: NDArray[np.float64]
    torque_nm: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TighteningResult:
    """What the gun's controller recorded. A joint counts once: by `controller_serial` and `tightening_id`."""

    key: str
    controller_serial: str
    tightening_id: int
    ok: bool
    torque_nm: float
    angle_deg: float
    torque_band: Band
    angle_band: Band
    trace: Trace
    time_s: float


@dataclass(frozen=True, slots=True)
class TurnResult:
    """A slow turn without tightening: how far the socket came and the largest torque met."""

    angle_deg: float
    peak_torque_nm: float
    time_s: float


class Gun(Device, Protocol):
    """A tightening spindle with its controller."""

    async def turn(self, angle_deg: float, *, speed_rpm: float, torque_limit_nm: float) -> TurnResult:
        """Turn the socket by `angle_deg` (positive tightens); stop early at `torque_limit_nm`."""
        ...

    async def tighten(self, key: str, program: TighteningProgram) -> TighteningResult:
        """Run `program` once; `key` is stored with the result. A key that was run before is refused, never rerun.

        Raises UnknownOutcome when the program may have run but no result came.
        """
        ...

    async def result(self, key: str) -> TighteningResult | None:
        """The stored result of `key`; None when the controller has none: then `key` was never run to its end."""
        ...


@dataclass(frozen=True, slots=True)
class ForceBlock:
    """Consecutive samples of one sensor, raw (weight included), newton, compression positive.

    `sequence` numbers the first sample since connect; sample i was taken at `time_s + i * period_s`.
    """

    sequence: int
    time_s: float
    period_s: float
    samples_n: NDArray[np.float64]


class ForceSensor(Device, Protocol):
    """A streaming force sensor. It has one reader: the jack's is read by the guard alone."""

    @property
    def rate_hz(self) -> float: ...
    @property
    def range_n(self) -> float: ...
    async def block(self, count: int, *, low_n: float = -math.inf, high_n: float = math.inf) -> ForceBlock:
        """The next `count` samples; returns when the last of them was taken.

        It ends early with the first sample that is not within [low_n, high_n] (raw newton; NaN never is), so that
        a reader reacts to one sample and need not be woken for each.
        """
        ...


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """What the guard lets pass while armed: net force (raw minus tare) within [low_n, trip_n], sample age below
    `stale_ms`. `block` is the number of samples that it looks at in one go."""

    label: str
    tare_n: float
    trip_n: float
    low_n: float
    stale_ms: float
    block: int


@dataclass(frozen=True, slots=True)
class GuardState:
    """`tripped` latches until `rearm`. Peak and last are net forces since the last arm, newton."""

    armed: bool
    tripped: bool
    reason: str
    peak_n: float
    last_n: float
    samples: int
    time_s: float


class ForceGuard(Protocol):
    """The only reader of the jack's force sensor; halts every force-producing axis on a trip and latches.

    Known here so that the cell can build it in the loop or as a client of the guard process.
    """

    async def arm(self, limits: GuardLimits) -> None: ...
    async def disarm(self) -> GuardState: ...
    async def rearm(self) -> None: ...
    def state(self) -> GuardState: ...
    async def window(self, seconds: float) -> ForceBlock:
        """The samples of the next `seconds`, read while nothing else is asked of the sensor's owner."""
        ...


class Thermometer(Device, Protocol):
    """One temperature channel, degrees Celsius."""

    async def read(self) -> Reading: ...


@dataclass(frozen=True, slots=True)
class HeaterState:
    """Read-back of the heater controller."""

    setpoint_c: float
    power_w: float
    on: bool
    watchdog_armed: bool
    alarm: str
    time_s: float


class Heater(Device, Protocol):
    """A heater controller that regulates the spigot's temperature itself and trips off-line on a lost link."""

    @property
    def max_power_w(self) -> float: ...
    async def read(self) -> HeaterState: ...
    async def heat(self, setpoint_c: float, *, ramp_k_per_min: float, max_power_w: float) -> HeaterState:
        """Regulate to `setpoint_c`, the set-point rising no faster than the ramp. Returns once read back."""
        ...

    async def off(self) -> HeaterState: ...


@dataclass(frozen=True, slots=True)
class ChuckState:
    """Two independent feedbacks; `clamped` only if both say so and the pressure holds."""

    clamped_1: bool
    clamped_2: bool
    pressure_bar: float
    time_s: float


class Chuck(Device, Protocol):
    """Holds the shaft against turning and tilting."""

    async def read(self) -> ChuckState: ...
    async def clamp(self) -> ChuckState: ...
    async def release(self) -> ChuckState: ...


@dataclass(frozen=True, slots=True)
class ParkState:
    """Where the camera arm is; `position` is None while it moves or when the two feedbacks disagree."""

    position: Literal["parked", "rotor", "shaft"] | None
    time_s: float


class CameraPark(Device, Protocol):
    """The arm that brings the camera into its two views and parks it."""

    async def read(self) -> ParkState: ...
    async def go(self, position: Literal["parked", "rotor", "shaft"]) -> ParkState: ...


class NutFeeder(Device, Protocol):
    """Puts one nut from the magazine into a gun's socket."""

    async def count(self) -> int: ...
    async def load(self, gun: Literal["a", "b"]) -> bool:
        """Load one nut; true when the presence sensor sees it in the socket."""
        ...


class GapProbe(Device, Protocol):
    """Distance between the two faces at one place, millimetres."""

    async def read(self) -> Reading: ...


@dataclass(frozen=True, slots=True)
class SafetyState:
    """Mirror of the hard-wired circuit; None means unknown, and unknown counts as tripped."""

    estop_released: bool | None
    guards_closed: bool | None
    sto_released: bool | None
    bench_locked: bool | None
    bench_moved: bool | None
    time_s: float

    @property
    def ok(self) -> bool:
        """Whether motion may be asked for."""
        return (
            self.estop_released is True
            and self.guards_closed is True
            and self.sto_released is True
            and self.bench_locked is True
            and self.bench_moved is False
        )


class SafetyInputs(Device, Protocol):
    """Read-only mirror of e-stop, guards, STO and bench lock."""

    async def read(self) -> SafetyState: ...


class PartStation(Device, Protocol):
    """Presents the parts of an order and reads their serial numbers back (code reader or operator)."""

    async def present(self, rotor: str, shaft: str) -> tuple[str, str]:
        """Ask for the two parts; returns the serial numbers that were read on them."""
        ...


@dataclass(frozen=True, slots=True)
class Frame:
    """One organised cloud in the scanner's own frame.

    `points_mm` is (H, W, 3) float32, NaN where nothing was measured; z points away from the camera.
    `frame_id` grows with each capture; a repeated one is an old frame.
    """

    frame_id: int
    view: View
    time_s: float
    points_mm: NDArray[np.float32]


class Scanner(Device, Protocol):
    """A structured-light binocular camera."""

    async def capture(self, view: View) -> Frame: ...
