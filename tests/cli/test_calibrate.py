"""`cellctl calibrate` from the outside: a file comes of it, or a refusal and no file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cellctl.calibration import load_calibration
from tests.cli.shell import ROOT, cellctl

CELL = str(ROOT / "deploy" / "cell.fake.toml")


def calibrate(output: Path, *more: str) -> int:
    return cellctl("calibrate", *more, "--cell", CELL, "-o", str(output), "--json", "--points", "40000")


def test_force_then_camera_into_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "calibration.toml"
    assert calibrate(output, "force", "--set", "force_gain=1.1", "--masses", "0,50,100,150") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["stops"] == 4
    assert "jack_force-1" in told["devices"]["jack_force"]
    assert calibrate(output, "camera", "--looks", "3", "--set", "camera_rotor_shift_x_mm=0.5") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["figures"]["rotor_moved_mm"] == pytest.approx(0.5, abs=0.1)
    found = load_calibration(output)
    assert found.jack_force.gain == pytest.approx(1.0 / 1.1, rel=0.01)
    assert set(found.made) == {"force", "camera"}
    assert found.views["rotor"].T_cell_scanner[0][3] == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(
    ("more", "code"),
    [
        (("--masses", "80,85,90"), "geometry_too_weak"),
        (("--masses", "0,100,210"), "guard_tripped"),
        (("--set", "force_gain=0.102"), "wrong_unit"),
        (("--valid-days", "0"), "calibration_expired"),
    ],
)
def test_a_refusal_writes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: tuple[str, ...], code: str
) -> None:
    assert calibrate(tmp_path / "c.toml", "force", *more) == 3
    assert json.loads(capsys.readouterr().out)["refused"]["code"] == code
    assert list(tmp_path.iterdir()) == []


def test_files_that_are_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert calibrate(tmp_path / "c.toml", "force", "--base", str(tmp_path / "none.toml")) == 2
    assert "none.toml" in capsys.readouterr().err
