"""Who hears what on a bus: listeners by identifier, and receive deadlines of those that must be heard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from hal.codec.lawicel import CanFrame


class Listener(Protocol):
    """Who gets frames."""

    def frame(self, frame: CanFrame) -> None: ...
    def down(self, reason: str) -> None:
        """The link is lost; frames may have been missed."""
        ...


class Link(Protocol):
    """What a node needs of a bus: the adapter in this process, or a client of whoever owns it."""

    async def open(self) -> None: ...
    async def release(self) -> None: ...
    def send(self, frame: CanFrame) -> None: ...
    def subscribe(self, can_id: int, listener: Listener) -> Callable[[], None]: ...
    def watch(self, can_id: int, within_s: float, lost: Callable[[], None]) -> Callable[[], None]: ...


@dataclass(slots=True, eq=False)
class _Watch:
    """A receive deadline; `heard_s` is None until the identifier is heard first, and once it is lost."""

    can_id: int
    within_s: float
    lost: Callable[[], None]
    heard_s: float | None = None


class Ears:
    """Times are the loop's, given by whoever calls."""

    def __init__(self) -> None:
        self._listeners: dict[int, list[Listener]] = {}
        self._every: list[Listener] = []
        self._watches: list[_Watch] = []
        self.heard_s = 0.0
        """When anything was heard last."""

    @property
    def watching(self) -> bool:
        """Whether anything must be heard."""
        return bool(self._watches)

    def subscribe(self, can_id: int, listener: Listener) -> Callable[[], None]:
        """Hand frames with `can_id` to `listener`; returns what ends that."""
        self._listeners.setdefault(can_id, []).append(listener)
        return lambda: self._listeners[can_id].remove(listener)

    def every(self, listener: Listener) -> Callable[[], None]:
        """Hand every frame to `listener`; returns what ends that."""
        self._every.append(listener)
        return lambda: self._every.remove(listener)

    def watch(self, can_id: int, within_s: float, lost: Callable[[], None], now: float) -> Callable[[], None]:
        """Call `lost` once whenever `can_id`, heard before, is not heard within `within_s`; returns what ends that."""
        if not self._watches:
            self.heard_s = now
        watch = _Watch(can_id, within_s, lost)
        self._watches.append(watch)
        return lambda: self._watches.remove(watch)

    def heard(self, frame: CanFrame, now: float) -> None:
        """`frame` has come."""
        self.heard_s = now
        for watch in self._watches:
            if watch.can_id == frame.can_id:
                watch.heard_s = now
        for listener in (*self._every, *self._listeners.get(frame.can_id, ())):
            listener.frame(frame)

    def down(self, reason: str) -> None:
        """The link is lost: everybody hears it once, and nothing is overdue until it is heard again."""
        for watch in self._watches:
            watch.heard_s = None
        everybody = [*self._every, *(one for many in self._listeners.values() for one in many)]
        for listener in {id(one): one for one in everybody}.values():
            listener.down(reason)

    def look(self, now: float) -> None:
        """Tell of what is overdue."""
        for watch in tuple(self._watches):
            if watch.heard_s is not None and now - watch.heard_s > watch.within_s:
                watch.heard_s = None
                watch.lost()
