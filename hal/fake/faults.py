"""The fault book: what each fake asks before it answers.

How a fake uses it::

    await self._faults.gate(self.name, "move_to")             # first line of every command, halt and safe included
    if self._faults.active(self.name, "following_error", now): ...
    if self._faults.take(self.name, "missing_nut", now): ...  # acts once only
    return self._faults.reading(self.name, value, now)        # whatever gives a number

``close`` never asks: it never fails. Time is the event loop's. The composition root calls ``enter_phase`` when the run
enters a phase; a fault begins when its phase is entered first. A hard-wired stop takes the power from every drive,
gun and heater at once: those fakes ask ``power_cut`` before they act and while they act.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hal.errors import DeviceTimeout, NotConnected
from hal.fake.fault_file import Expect, Fault, FaultFile, load_faults, parse_faults, wrong_places
from hal.interfaces import Quality, Reading

__all__ = ["Expect", "Fault", "FaultBook", "FaultFile", "load_faults", "parse_faults", "wrong_places"]

EXCHANGE_DEADLINE_S = 2.0
"""A backend gives one exchange so long before it raises DeviceTimeout."""

POWER_CUTS = ("estop", "guard_open", "sto_open", "channels_disagree")
"""Kinds of the device ``safety`` that open the hard-wired circuit."""


@dataclass(slots=True)
class _Waiting:
    """What is to happen when `fault` begins; `timer` once that instant is known."""

    fault: Fault
    act: Callable[[], None]
    timer: asyncio.TimerHandle | None = None


class FaultBook:
    """The faults of one run and what has become of them. One instance is shared by all fakes of a cell."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._by_device: dict[str, tuple[Fault, ...]] = {}
        for fault in faults:
            self._by_device[fault.device] = (*self._by_device.get(fault.device, ()), fault)
        self._entered_s: dict[str, float] = {}
        self._taken: set[int] = set()
        self._last_good: dict[str, Reading] = {}
        self._waiting: list[_Waiting] = []

    def enter_phase(self, name: str, now: float) -> None:
        """The run enters phase `name` at loop time `now`; only the first time counts."""
        self._entered_s.setdefault(name, now)
        self._set_timers()

    def when(self, device: str, kind: str, act: Callable[[], None]) -> Callable[[], None]:
        """Call `act` when a fault of this kind begins, for what happens in metal though nobody asks; returns what
        ends that. Must be called inside the running loop."""
        mine = [_Waiting(fault, act) for fault in self._by_device.get(device, ()) if fault.kind == kind]
        self._waiting += mine
        self._set_timers()

        def end() -> None:
            for waiting in mine:
                if waiting.timer is not None:
                    waiting.timer.cancel()
            self._waiting = [waiting for waiting in self._waiting if waiting not in mine]

        return end

    def _set_timers(self) -> None:
        for waiting in self._waiting:
            start_s = self.start_s(waiting.fault)
            if waiting.timer is None and start_s < math.inf:
                waiting.timer = asyncio.get_running_loop().call_at(start_s, waiting.act)

    def start_s(self, fault: Fault) -> float:
        """Loop time at which `fault` begins; infinite while its phase has not been entered."""
        return fault.at_s + (self._entered_s.get(fault.phase, math.inf) if fault.phase else 0.0)

    def any_of(self, device: str) -> bool:
        """Whether `device` has faults at all, now or ever."""
        return device in self._by_device

    def active(self, device: str, kind: str, now: float) -> Fault | None:
        """The fault of this kind that holds at `now`, or None."""
        for fault in self._by_device.get(device, ()):
            if fault.kind == kind and 0.0 <= now - self.start_s(fault) < fault.duration_s:
                return fault
        return None

    def take(self, device: str, kind: str, now: float) -> Fault | None:
        """As `active`, but each fault is given once: for errors that strike one command only."""
        for fault in self._by_device.get(device, ()):
            holds = fault.kind == kind and 0.0 <= now - self.start_s(fault) < fault.duration_s
            if holds and id(fault) not in self._taken:
                self._taken.add(id(fault))
                return fault
        return None

    def power_cut(self, now: float) -> str:
        """Why the hard-wired circuit has taken the power away at `now`; empty while it is closed."""
        if not self.any_of("safety"):
            return ""
        return next((kind for kind in POWER_CUTS if self.active("safety", kind, now)), "")

    def next_change(self, device: str, now: float) -> float:
        """The first loop time after `now` at which a known fault of `device` begins or ends; infinite if none."""
        if not self.any_of(device):
            return math.inf
        edges = (
            edge
            for fault in self._by_device.get(device, ())
            for edge in (self.start_s(fault), self.start_s(fault) + fault.duration_s)
        )
        return min((edge for edge in edges if edge > now), default=math.inf)

    async def gate(self, device: str, command: str, *, deadline_s: float = EXCHANGE_DEADLINE_S) -> None:
        """Pass, or fail as the device would at `command`.

        Raises NotConnected (gone) and DeviceTimeout (hung, or late beyond `deadline_s`). A device that hangs for less
        than the deadline answers when it has come back.
        """
        if device not in self._by_device:
            return
        now = asyncio.get_running_loop().time()
        if self.active(device, "gone", now):
            raise NotConnected(f"no link ({command})", device=device)
        delay_s = 0.0
        if hung := self.active(device, "hung", now):
            delay_s = self.start_s(hung) + hung.duration_s - now
        if late := self.active(device, "late", now):
            delay_s = max(delay_s, late.number)
        if delay_s > 0.0:
            await asyncio.sleep(min(delay_s, deadline_s))
        if delay_s > deadline_s:
            raise DeviceTimeout(f"no answer to {command} within {deadline_s:g} s", device=device)

    def reading(self, device: str, value: float, now: float) -> Reading:
        """What the device reads where the truth is `value`. A sensor that knows of its failure says BAD."""
        if device not in self._by_device:
            return Reading(value, now)
        if self.active(device, "nan", now):
            return Reading(math.nan, now, Quality.BAD)
        if fault := self.active(device, "out_of_range", now):
            return Reading(fault.number, now, Quality.BAD)
        if fault := self.active(device, "stale", now):
            return self._last_good.setdefault(device, Reading(value, self.start_s(fault)))
        if fault := self.active(device, "stuck", now):
            last = self._last_good.setdefault(device, Reading(value, self.start_s(fault)))
            return Reading(last.value if fault.value is None else fault.value, now)
        self._last_good[device] = Reading(value, now)
        if fault := self.active(device, "drift", now):
            return Reading(value + fault.number * (now - self.start_s(fault)), now)
        return Reading(value, now)

    def samples(self, device: str, values: NDArray[np.float64], times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """As `reading` for a stream: true values (n,) taken at `times_s` (n,), ascending. Times are not changed here:
        a stream that is ``stale`` delivers nothing new, which its sensor acts out with `active`."""
        faults = self._by_device.get(device, ())
        if not faults or len(values) == 0:
            return values
        read = np.array(values, dtype=np.float64)
        for fault in faults:
            begin = self.start_s(fault)
            held = (times_s >= begin) & (times_s < begin + fault.duration_s)
            if not held.any():
                continue
            if fault.kind == "nan":
                read[held] = math.nan
            elif fault.kind == "out_of_range":
                read[held] = fault.number
            elif fault.kind == "drift":
                read[held] += fault.number * (times_s[held] - begin)
            elif fault.kind == "stuck":
                first = int(np.argmax(held))
                if first > 0:
                    self._last_good[device] = Reading(float(values[first - 1]), float(times_s[first - 1]))
                before = self._last_good.setdefault(device, Reading(float(values[0]), begin))
                read[held] = before.value if fault.value is None else fault.value
        if not self.active(device, "stuck", float(times_s[-1])):
            self._last_good[device] = Reading(float(values[-1]), float(times_s[-1]))
        return read
