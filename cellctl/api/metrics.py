"""Numbers for Prometheus, in a registry of their own."""

from __future__ import annotations

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from cellctl.controller import Controller
from cellctl.event_log import EventLog
from cellctl.states import State


class Metrics:
    """Counters, and the cell as it is at the moment of each scrape."""

    def __init__(self, controller: Controller, events: EventLog) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_CellNow(controller, events))
        self._commands = Counter(
            "cellctl_commands", "Commands that were taken or refused", ["command", "taken"], registry=self._registry
        )
        self._runs = Counter("cellctl_runs", "Runs that ended", ["ending", "verdict"], registry=self._registry)

    def command(self, command: str, *, taken: bool) -> None:
        """Count a command."""
        self._commands.labels(command, str(taken).lower()).inc()

    def run_ended(self, ending: str, verdict: str) -> None:
        """Count a run."""
        self._runs.labels(ending, verdict).inc()

    def text(self) -> bytes:
        """Prometheus text format 0.0.4."""
        return generate_latest(self._registry)


class _CellNow(Collector):
    def __init__(self, controller: Controller, events: EventLog) -> None:
        self._controller = controller
        self._events = events

    def describe(self) -> Iterator[Metric]:
        """Nothing beforehand: the registry need not ask for values to know the names."""
        return iter(())

    def collect(self) -> Iterator[Metric]:
        snapshot = self._controller.snapshot()
        state = GaugeMetricFamily("cellctl_state", "1 for the PackML state that the cell is in", labels=["state"])
        for each in State:
            state.add_metric([str(each)], float(each is snapshot.state))
        yield state
        alarms = GaugeMetricFamily("cellctl_alarms", "Alarms that stand", labels=["latched"])
        for latched in (False, True):
            count = sum(alarm.latched is latched for alarm in snapshot.alarms)
            alarms.add_metric([str(latched).lower()], float(count))
        yield alarms
        yield GaugeMetricFamily("cellctl_unsafe_devices", "Devices not proven safe", value=float(len(snapshot.unsafe)))
        yield GaugeMetricFamily("cellctl_phase_ratio", "Progress of the phase, 0 to 1", value=snapshot.fraction)
        yield GaugeMetricFamily("cellctl_event_sequence", "Number of the newest event", value=float(self._events.last))
