"""The wire cell's file: every device by a protocol, and the same cell on fakes for a dry run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hal.cell import build_cell
from hal.config import CellConfig, load_cell
from hal.errors import ConfigError


def test_a_cell_on_the_wire_has_no_fakes_and_the_same_cell_on_fakes_has_its_numbers(root: Path) -> None:
    wire = load_cell(root / "deploy/cell.wire.toml")
    assert "fake" not in wire.kinds.values()
    fakes = wire.on_fakes()
    assert set(fakes.kinds.values()) == {"fake"}
    other = load_cell(root / "deploy/cell.fake.toml")
    assert _but_speeds(fakes) == _but_speeds(other)
    assert fakes.on_fakes() == fakes


def _but_speeds(cell: CellConfig) -> dict[str, Any]:
    """The devices' numbers; some axes of the bench are quicker."""
    numbers: dict[str, Any] = cell.devices.model_dump()
    for entry in numbers.values():
        for name in ("max_speed", "max_acceleration"):
            entry.pop(name, None)
    return numbers


def test_files_are_found_beside_the_cell_file(root: Path) -> None:
    wire = load_cell(root / "deploy/cell.wire.toml")
    assert wire.beside("x/y") == root / "deploy/x/y"
    assert wire.beside("/dev/ttyS0") == Path("/dev/ttyS0")


def test_fakes_without_a_plant_are_refused(root: Path) -> None:
    with pytest.raises(ConfigError, match="plant"):
        build_cell(load_cell(root / "deploy/cell.fake.toml"))
