"""A whole assembly with guns of another maker, everything over the devices' own protocols."""

from __future__ import annotations

from pathlib import Path

import pytest

from hal.config import CellConfig
from hal.entries import KducerEntry
from tests.journeys.test_wire_cell import BRISK
from tests.journeys.twin_runs import small_recipe
from tests.journeys.wire_runs import assembled_over_the_wire, wire_cell


def with_kolvers(config: CellConfig) -> CellConfig:
    """The same cell with other guns, at the same ports."""
    guns = {
        name: KducerEntry(kind="kducer", host="127.0.0.1", port=getattr(config.devices, name).port, lever_s=0.6)
        for name in ("gun_a", "gun_b")
    }
    return config.model_copy(update={"devices": config.devices.model_copy(update=guns)})


@pytest.mark.nightly  # 90 s of CPU
def test_an_assembly_with_kolver_guns_is_accepted(tmp_path: Path) -> None:
    config = with_kolvers(wire_cell(tmp_path, **BRISK))
    outcome, truth = assembled_over_the_wire(small_recipe(4), config, tmp_path / "data")
    assert outcome.verdict == "accepted", (outcome.state, outcome.reasons)
    assert truth.good, truth.reasons
