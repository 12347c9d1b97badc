"""Trips raced with motion commands."""

from __future__ import annotations

import pytest

from hal.guard.gate import Gate
from tests.dead.races import raced


@pytest.mark.parametrize("seed", range(4))
def test_no_trip_is_undone_by_a_motion_command(seed: int) -> None:
    assert raced(seed, 50) == ""


def test_a_gate_without_epochs_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or the race would prove nothing."""
    monkeypatch.setattr(Gate, "passes", lambda self, frame, epoch: True)
    assert "enabled while latched" in raced(0, 20)
