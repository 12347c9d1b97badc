"""The calibration file: written whole, read back to the same values, old files readable, faults of covariances told."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from cellctl.calibrating import file
from cellctl.calibrating.entry import Part, put_in
from cellctl.calibration import AxisLine, Made, ViewCalibration, load_calibration
from cellctl.vision.part import Refused
from hal.errors import ConfigError
from tests.journeys.twin_runs import ROOT

OLD = load_calibration(ROOT / "deploy" / "calibration.fake.toml")
NOW = datetime(2026, 5, 1, 12, 0, tzinfo=UTC)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    made = Made(at=NOW, devices={"jack.force": 'cell "7"\\\n\u00b5'}, stops=5, figures={"residual_mm": 1e-7})
    line = OLD.table_axis.model_copy(update={"covariance": tuple(map(tuple, np.diag([1e-6, 2e-6, 3e-9, 4e-9])))})
    whole = OLD.model_copy(update={"made": {"force": made}, "table_axis": line})
    file.save_calibration(tmp_path / "c.toml", whole)
    assert load_calibration(tmp_path / "c.toml") == whole
    assert [path.name for path in tmp_path.iterdir()] == ["c.toml"]


def test_a_write_that_fails_leaves_the_file_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "c.toml"
    file.save_calibration(path, OLD)

    def full(_: int) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="disk full"):
        file.save_calibration(path, OLD.model_copy(update={"id": "other"}))
    assert load_calibration(path) == OLD
    assert [one.name for one in tmp_path.iterdir()] == ["c.toml"]


@pytest.mark.parametrize(
    ("covariance", "said"),
    [
        ([[1.0] * 6] * 5, "6 x 6"),
        (np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]).tolist(), "positive"),
        ((np.eye(6) + np.eye(6, k=1)).tolist(), "symmetric"),
    ],
)
def test_a_covariance_that_is_none_is_told_at_its_place(
    tmp_path: Path, covariance: list[list[float]], said: str
) -> None:
    text = file.as_toml(OLD).replace("[views.shaft]", f"[views.shaft]\ncovariance = {covariance}")
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(ConfigError, match=said) as error:
        load_calibration(tmp_path / "c.toml")
    assert error.value.place == "c.toml.views.shaft"


def test_a_covariance_takes_the_place_of_the_plain_sigmas() -> None:
    view = OLD.views["rotor"]
    plain = view.errors()
    assert np.diag(plain) == pytest.approx([0.0014] * 3 + [0.0035] * 3)
    matrix = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]) * 1e-6
    matrix[0, 4] = matrix[4, 0] = 1e-6
    told = ViewCalibration.model_validate(view.model_dump() | {"covariance": tuple(map(tuple, matrix))}).errors()
    np.testing.assert_allclose(told @ told.T, matrix, atol=1e-18)
    line = AxisLine(sigma_direction_deg=0.002, sigma_position_mm=0.003)
    assert np.diag(line.errors(placed=True)) == pytest.approx([0.003, 0.003, 0.002, 0.002])
    assert np.diag(line.errors(placed=False)) == pytest.approx([0.0, 0.0, 0.002, 0.002])


def test_a_part_takes_its_place_and_leaves_the_others() -> None:
    force = OLD.jack_force.model_copy(update={"gain": 1.1})
    part = Part("force", {"jack_force": force}, 5, {"noise_n": 0.1})
    found = put_in(OLD, part, name="cell", started=NOW, until=None, devices={"jack_force": "one"})
    assert found.jack_force.gain == 1.1
    assert found.views == OLD.views
    assert (found.valid_from, found.valid_until) == (NOW, OLD.valid_until)
    assert found.id == "cell-20260501T120000-force"
    assert found.made["force"].devices == {"jack_force": "one"}
    with pytest.raises(Refused, match="calibration_expired"):
        put_in(OLD, part, name="cell", started=NOW, until=NOW - timedelta(days=1), devices={})
