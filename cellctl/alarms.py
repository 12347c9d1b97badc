"""What is wrong with the cell at the moment."""

from __future__ import annotations

from dataclasses import dataclass

from cellctl.event_log import EventLog


@dataclass(frozen=True, slots=True)
class Alarm:
    """Something that is wrong. A latched one goes only with a successful clear."""

    code: str
    text: str
    latched: bool


class AlarmBoard:
    """The alarms that stand, one per code; each change is an event."""

    def __init__(self, events: EventLog) -> None:
        self._events = events
        self._standing: dict[str, Alarm] = {}

    @property
    def standing(self) -> tuple[Alarm, ...]:
        """All alarms, oldest first."""
        return tuple(self._standing.values())

    @property
    def latched(self) -> Alarm | None:
        """The oldest latched alarm."""
        return next((alarm for alarm in self._standing.values() if alarm.latched), None)

    def set(self, code: str, text: str, *, latched: bool) -> None:
        """Let an alarm stand; a latched one stays latched."""
        before = self._standing.get(code)
        alarm = Alarm(code, text, latched or (before is not None and before.latched))
        if alarm != before:
            self._standing[code] = alarm
            self._events.publish("alarm", {"code": code, "text": text, "latched": alarm.latched})

    def clear(self) -> None:
        """Take all away."""
        if self._standing:
            self._standing.clear()
            self._events.publish("alarms_cleared", {})
