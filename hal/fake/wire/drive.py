"""A CiA 402 drive with one axis of the plant behind it: its objects, states and motions. No bus is known here.

It follows `hal.fake.devices.axes` in everything physical; what differs is that it obeys controlwords, not calls.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hal.codec import cia402 as cia
from hal.codec.cia301 import Entry
from hal.codec.cia402 import Mode, State
from hal.fake.devices.axes import HOMING_S
from hal.fake.faults import POWER_CUTS, FaultBook
from hal.fake.motion import AxisMotion
from hal.fake.plant import Plant

MOTOR_STEPS = 10_000
"""Encoder increments per motor revolution."""
REFERENCED = 15
"""Bit of the statusword that says that the reference is valid."""

_READ_ONLY = (cia.STATUSWORD, cia.MODE_SHOWN, cia.POSITION, cia.VELOCITY, cia.ERROR_CODE, cia.OUTPUTS)


class Drive:
    """`changed` is called after each change of the statusword, `emergency` with an error code (0: it is over)."""

    def __init__(
        self,
        name: str,
        plant: Plant,
        faults: FaultBook,
        scale: float,
        feed: int,
        *,
        changed: Callable[[], None],
        emergency: Callable[[int], None],
    ) -> None:
        self._name, self._plant, self._faults, self._scale = name, plant, faults, scale
        self._changed, self._emergency = changed, emergency
        self._loop = asyncio.get_running_loop()
        self._timers: set[asyncio.TimerHandle] = set()
        self.values: dict[Entry, int] = _defaults(feed)
        self.state = State.OPERATION_ENABLED if self._motion.enabled else State.SWITCH_ON_DISABLED
        self._mode = Mode.PROFILE_POSITION
        self._word = 0
        self._acknowledged = False
        self._reached = not self._motion.moving(self._loop.time())
        self._error = 0
        self._ends = [faults.when("safety", kind, self._power_lost) for kind in POWER_CUTS]
        self._ends += [
            faults.when(name, "following_error", self._trip),
            faults.when(name, "home_lost", self._home_lost),
            faults.when(name, "hung", self._hang),
        ]
        if faults.power_cut(self._loop.time()):
            self._power_lost()

    def close(self) -> None:
        """No timer is left."""
        for end in self._ends:
            end()
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    # ------------------------------------------------------------ objects

    def read(self, entry: Entry) -> int | None:
        """The value of one object; None where there is none."""
        now = self._loop.time()
        self._plant.advance(now)
        match entry:
            case cia.STATUSWORD:
                return self._status(now)
            case cia.MODE_SHOWN:
                return self._mode
            case cia.POSITION:
                return round(self._motion.position(now) * self._scale)
            case cia.VELOCITY:
                return round(self._motion.velocity(now) * self._scale)
            case cia.ERROR_CODE:
                return self._error
            case cia.OUTPUTS:
                return cia.BRAKE_SET if now >= self._motion.brake_closes_s else 0
        return self.values.get(entry)

    def write(self, entry: Entry, value: int) -> bool:
        """Whether the object may be written and takes `value`."""
        if entry in _READ_ONLY or entry not in self.values:
            return False
        if entry == cia.MODE:
            if value not in (Mode.PROFILE_POSITION, Mode.HOMING):
                return False
            self._switch(Mode(value))
        self.values[entry] = value
        if entry == cia.CONTROLWORD:
            self._control(value)
        return True

    def entry(self, index: int, sub: int) -> Entry | None:
        """The object at an address, or None."""
        return next((one for one in (*self.values, *_READ_ONLY) if (one.index, one.sub) == (index, sub)), None)

    def _status(self, now: float) -> int:
        word = self.state.value[1] | 1 << 9
        flags = {
            cia.VOLTAGE: not self._faults.power_cut(now),
            cia.TARGET_REACHED: self._reached,
            cia.ACKNOWLEDGED: self._acknowledged,
            REFERENCED: self._motion.homed and not self._faults.active(self._name, "home_lost", now),
        }
        return word | sum(1 << bit for bit, up in flags.items() if up)

    # ------------------------------------------------------------ commands

    def _control(self, word: int) -> None:
        before, self._word = self._word, word
        state = cia.commanded(self.state, word, before)
        if self._faults.power_cut(self._loop.time()) and state is not State.FAULT:
            state = State.SWITCH_ON_DISABLED
        if state is not self.state:
            self._enter(state)
        if self.state is State.OPERATION_ENABLED:
            started = word & ~before & cia.START
            if self._mode is Mode.HOMING and started:
                self._home()
            elif self._mode is Mode.PROFILE_POSITION and started:
                self._acknowledged = True
                self._changed()
                self._go()
            elif self._mode is Mode.PROFILE_POSITION and not word & cia.START:
                self._acknowledged = False
        self._changed()

    def _switch(self, mode: Mode) -> None:
        if mode is not self._mode:
            self._mode, self._acknowledged = mode, False

    def _enter(self, state: State) -> None:
        left, self.state = self.state, state
        if left is State.FAULT:
            self._error = 0
            self._emergency(0)
        match state:
            case State.OPERATION_ENABLED:
                self._motion.enabled = True
                self._reached = True
            case State.QUICK_STOP_ACTIVE:
                self._stop()
            case State.SWITCH_ON_DISABLED if self._moving():
                self._stop()

    def _go(self) -> None:
        """The set-point of profile position becomes a motion."""
        now = self._loop.time()
        if self._faults.active(self._name, "stale_target", now):
            return
        low, high = self.values[cia.LIMIT_LOW], self.values[cia.LIMIT_HIGH]
        target = min(max(self.values[cia.TARGET], low), high)
        self._move(target, self.values[cia.PROFILE_VELOCITY], self.values[cia.PROFILE_ACCELERATION], self._arrived)

    def _home(self) -> None:
        """To the reference switch at 0, as far as the limits let it."""
        self._acknowledged = False
        low, high = self.values[cia.LIMIT_LOW], self.values[cia.LIMIT_HIGH]
        speed, ramp = self.values[cia.HOMING_SPEED], self.values[cia.HOMING_ACCELERATION]
        self._move(min(max(0, low), high), speed, ramp, lambda: self._later(HOMING_S, self._found))

    def _move(self, target: int, speed: int, ramp: int, done: Callable[[], None]) -> None:
        now = self._loop.time()
        self._reached = False
        trajectory = self._plant.start_move(
            self._name, target / self._scale, speed=speed / self._scale, acceleration=ramp / self._scale, now=now
        )
        if self._faults.active(self._name, "following_error", now) and self._moving():
            self.fail(cia.FOLLOWING_ERROR)
            return

        def ended() -> None:
            if self._motion.now_at is trajectory and self.state is State.OPERATION_ENABLED:
                self._plant.advance(self._loop.time())
                done()

        self._at(trajectory.end_s, ended)

    def _arrived(self) -> None:
        self._reached = True
        self._changed()

    def _found(self) -> None:
        if self.state is State.OPERATION_ENABLED and self._mode is Mode.HOMING and not self._moving():
            self._motion.homed = self._faults.active(self._name, "home_lost", self._loop.time()) is None
            self._acknowledged = self._reached = True
            self._changed()

    # ------------------------------------------------------------ stops and faults

    def _stop(self) -> None:
        """On the quick stop ramp, after the drive's own delay; "reached" once it stands."""
        self._reached = self._acknowledged = False
        self._later(self._plant.numbers.properties.drive_delay_s, self._brake)

    def _brake(self) -> None:
        now = self._loop.time()
        deceleration = self.values[cia.QUICK_STOP_DECELERATION] / self._scale
        end_s = self._plant.stop(self._name, deceleration, now).end_s
        if self.state is State.FAULT_REACTION:
            end_s = max(end_s, self._motion.brake_closes_s)  # the brake holds before the torque goes
        self._at(max(end_s, now), self._stands)

    def _stands(self) -> None:
        if self._moving():
            return
        if self.state is State.FAULT_REACTION:
            self.state = State.FAULT
        self._reached = True
        self._changed()

    def fail(self, code: int) -> None:
        """The drive trips with an error code: it stops and stays in fault."""
        if self.state in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
            self.state, self._error = State.FAULT_REACTION, code
            self._emergency(code)
            self._stop()
            self._changed()

    def connection_lost(self) -> None:
        """The controller's heartbeat is missed: what 0x6007 says."""
        option = self.values[cia.ABORT_CONNECTION]
        if option == cia.ABORT_QUICK_STOP and self.state is State.OPERATION_ENABLED:
            self._enter(State.QUICK_STOP_ACTIVE)
            self._changed()

    def restart(self) -> None:
        """Supply gone and back: motion, settings, states and the reference are lost."""
        now = self._loop.time()
        self._plant.cut_power(self._name, self.values[cia.QUICK_STOP_DECELERATION] / self._scale, now)
        self._motion.enabled = self._motion.homed = False
        self.values = _defaults(self.values[cia.FEED])
        self.state, self._mode, self._word, self._error = State.SWITCH_ON_DISABLED, Mode.PROFILE_POSITION, 0, 0
        self._acknowledged, self._reached = False, True

    def _trip(self) -> None:
        if self._moving():
            self.fail(cia.FOLLOWING_ERROR)

    def _home_lost(self) -> None:
        self._motion.homed = False
        self._changed()

    def _hang(self) -> None:
        """Its own watchdog stops what moves."""
        if self._moving() and self.state is State.OPERATION_ENABLED:
            self._enter(State.QUICK_STOP_ACTIVE)

    def _power_lost(self) -> None:
        now = self._loop.time()
        self._plant.advance(now)
        self._motion.enabled = False
        self._plant.cut_power(self._name, self.values[cia.QUICK_STOP_DECELERATION] / self._scale, now)
        if self.state is not State.FAULT:
            self.state = State.SWITCH_ON_DISABLED
        self._acknowledged = False
        self._changed()

    # ------------------------------------------------------------ inside

    @property
    def _motion(self) -> AxisMotion:
        return self._plant.motion[self._name]

    def _moving(self) -> bool:
        return self._motion.moving(self._loop.time())

    def _later(self, delay_s: float, act: Callable[[], None]) -> None:
        self._at(self._loop.time() + delay_s, act)

    def _at(self, time_s: float, act: Callable[[], None]) -> None:
        def run() -> None:
            self._timers.discard(timer)
            act()

        timer = self._loop.call_at(time_s, run)
        self._timers.add(timer)


def _defaults(feed: int) -> dict[Entry, int]:
    """What a drive has before it is told anything: a motor with its encoder, no gear, slow and without reactions."""
    everything = (one for one in vars(cia).values() if isinstance(one, Entry) and one not in _READ_ONLY)
    wide = 2**31 - 1
    return dict.fromkeys(everything, 0) | {
        cia.MODE: Mode.PROFILE_POSITION,
        cia.ENCODER_INCREMENTS: MOTOR_STEPS,
        cia.ENCODER_REVOLUTIONS: 1,
        cia.GEAR_MOTOR: 1,
        cia.GEAR_SHAFT: 1,
        cia.FEED: feed,
        cia.FEED_SHAFT: 1,
        cia.LIMIT_LOW: -wide,
        cia.LIMIT_HIGH: wide,
        cia.QUICK_STOP_OPTION: 2,
        cia.PROFILE_ACCELERATION: feed,
        cia.PROFILE_DECELERATION: feed,
        cia.QUICK_STOP_DECELERATION: feed,
        cia.HOMING_SPEED: feed,
        cia.HOMING_ACCELERATION: feed,
    }
