"""Faults at random moments: a few of each bus here, each of them twenty times by `python -m tests.wire.campaign`."""

from __future__ import annotations

import pytest

from hal.bus.open_protocol import Session
from hal.entries import OpenProtocolEntry
from hal.real.axes import CanAxis
from hal.real.gun import OpenProtocolGun
from tests.wire.campaign import BUSES, EVERYWHERE, NONE, PAIRS, numbered, strike

FEW = [pair for pair in PAIRS if pair[0] not in ("guard link", "GenTL scanner")][::3]
"""The others take seconds each, or start a process."""


@pytest.mark.parametrize(("bus", "fault"), FEW)
def test_a_strike_at_a_random_moment(bus: str, fault: str) -> None:
    assert strike(bus, fault, 101) == ""


def test_every_wire_does_what_any_wire_can_do() -> None:
    for bus, strikes in BUSES.items():
        for fault in EVERYWHERE:
            assert any(name.startswith(fault) for name in strikes) != ((bus, fault) in NONE), (bus, fault)
    assert any("result lost" in fault for fault in BUSES["Open Protocol gun"])
    assert numbered(2)[0] == PAIRS[2][0]


def test_a_gun_that_does_not_look_whether_a_key_was_run_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    async def never(self: OpenProtocolGun, session: Session, identifier: str) -> None:
        """No result is found under any key."""

    class Forgetful(set[str]):
        def __contains__(self, key: object) -> bool:
            return False

    made = OpenProtocolGun.__init__

    def forgetful(self: OpenProtocolGun, name: str, entry: OpenProtocolEntry) -> None:
        made(self, name, entry)
        self._started = Forgetful()

    monkeypatch.setattr(OpenProtocolGun, "_search", never)
    monkeypatch.setattr(OpenProtocolGun, "__init__", forgetful)
    assert "stored: False" in strike("Open Protocol gun", "result lost and fetched again", 0)
    assert "run again" in strike("Open Protocol gun", "controller restart in mid-tightening", 0)


def test_an_axis_that_stops_nothing_when_it_gives_up_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CanAxis, "_quick_stop", lambda self: None)
    assert any("still moves" in strike("CAN axis", "lost heartbeat of the drive", seed) for seed in range(4))
