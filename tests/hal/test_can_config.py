"""Axes on CAN in the cell file."""

from __future__ import annotations

from pathlib import Path

import pytest

from hal.config import load_cell
from hal.entries import CanAxisEntry
from hal.errors import ConfigError
from hal.real.axis_settings import motor_rpm, settings

CAN = '\n[can]\ninterface = "socketcan"\nchannel = "can0"\n'
AXIS = 'kind = "canopen", node = {node}, encoder_increments = 10000, feed = 100000, homing_method = 19'


def cell(root: Path, folder: Path, can: str, *, jack: int = 3, feed: int = 6) -> Path:
    """The example cell with jack and gun feed on CAN."""
    text = (root / "deploy" / "cell.fake.toml").read_text(encoding="utf-8")
    for name, node in (("jack", jack), ("gun_feed", feed)):
        text = text.replace(f'\n{name} = {{ kind = "fake"', f"\n{name} = {{ {AXIS.format(node=node)}")
    path = folder / "cell.toml"
    path.write_text(text + can, encoding="utf-8")
    return path


def test_axes_may_be_on_can_each_by_its_own_node(root: Path, tmp_path: Path) -> None:
    config = load_cell(cell(root, tmp_path, CAN))
    assert isinstance(config.devices.jack, CanAxisEntry)
    assert config.can is not None
    assert (config.devices.jack.node, config.can.node, config.devices.stage_x.kind) == (3, 127, "fake")


@pytest.mark.parametrize(
    ("can", "jack", "reason"),
    [("", 3, "no .can."), (CAN, 6, "must differ"), (CAN + "node = 3\n", 3, "must differ"), (CAN, 0, "greater")],
)
def test_what_cannot_work_is_refused(root: Path, tmp_path: Path, can: str, jack: int, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        load_cell(cell(root, tmp_path, can, jack=jack))


def test_a_drive_is_told_its_limits_in_its_own_units(root: Path, tmp_path: Path) -> None:
    entry = load_cell(cell(root, tmp_path, CAN)).devices.jack
    assert isinstance(entry, CanAxisEntry)
    told = {(one.index, one.sub): value for one, value in settings(entry, 127).items()}
    assert told[0x607D, 1] == 0
    assert told[0x607D, 2] == 4_200_000
    assert told[0x6083, 0] == 500_000
    assert told[0x6085, 0] == 2_000_000
    assert told[0x605A, 0] == 6
    assert told[0x6007, 0] == 3
    assert told[0x1016, 1] == 0x7F00C8
    assert motor_rpm(entry) == 120  # 20 mm/s at 10 mm per revolution
    assert motor_rpm(entry.model_copy(update={"gear_motor": 3, "gear_shaft": 2})) == 180
