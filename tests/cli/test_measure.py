"""`cellctl measure`: the document, the exit codes, one JSON document whatever happens."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import pytest

from cellctl.cli import measure as command
from tests.vision.parts import SHAFT
from tests.vision.synthetic import View, pose_above, render

ROOT = Path(__file__).parents[2]
RECIPE = ROOT / "recipes" / "lpt_shaft_36.toml"
CALIBRATION = ROOT / "deploy" / "calibration.fake.toml"


def run(*words: str) -> int:
    parser = ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return command.run(parser.parse_args(["measure", *words]))


@pytest.fixture(scope="module")
def cloud(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clouds") / "shaft.npz"
    grid = render(View(SHAFT, pose_above(350.0, shift=(1.0, -2.0)), pixels=450), np.random.default_rng(1))
    np.savez_compressed(path, points=grid)
    return path


def test_document(cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--recipe", str(RECIPE), "--shaft", str(cloud), "--json") == 0
    document = json.loads(capsys.readouterr().out)
    shaft = document["shaft"]
    assert document["frame"] == "input" and "rotor" not in document
    assert set(shaft["face"]) == {"point_mm", "normal", "flatness_mm", "sigma_mm"}
    assert np.array(shaft["T_frame_part"]).shape == (4, 4)
    assert len(shaft["features"]) == 36
    for number, feature in enumerate(shaft["features"]):
        assert feature["index"] == number and feature["found"]
        assert len(feature["center_mm"]) == len(feature["axis"]) == len(feature["covariance_mm2"]) == 3
    assert shaft["quality"]["coverage"] > 0.9


def test_cell_frame(cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--recipe", str(RECIPE), "--shaft", str(cloud), "--calibration", str(CALIBRATION), "--json")
    assert run(*words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["frame"] == "cell"
    assert np.allclose(np.array(document["shaft"]["T_frame_part"])[:3, 3], [1.0, 2.0, 0.0], atol=0.02)
    assert np.allclose(document["shaft"]["face"]["normal"], [0, 0, 1], atol=1e-4)


def test_a_person_gets_lines(cloud: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--recipe", str(RECIPE), "--shaft", str(cloud)) == 0
    assert "36 of 36 holes found" in capsys.readouterr().out


def test_view_shows_the_cloud(cloud: Path, tmp_path: Path) -> None:
    view = tmp_path / "view.html"
    assert run("--recipe", str(RECIPE), "--shaft", str(cloud), "--view", str(view)) == 0
    page = view.read_text(encoding="utf-8")
    assert "all 36 holes found" in page and "shaft.npz" in page and "lpt_shaft_36 version 1" in page
    assert run("--recipe", str(RECIPE), "--shaft", str(cloud), "--view", str(tmp_path / "none" / "view.html")) == 2


def test_missing_features_have_nulls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    view = View(SHAFT, pose_above(350.0), pixels=450, missing=(3,))
    np.save(tmp_path / "a.npy", render(view, np.random.default_rng(2)))
    assert run("--recipe", str(RECIPE), "--shaft", str(tmp_path / "a.npy"), "--json") == 0
    lost = json.loads(capsys.readouterr().out)["shaft"]["features"][3]
    assert lost["found"] is False and lost["center_mm"] is None and lost["axis"] is None and lost["radius_mm"] is None


def test_refused(cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    metres = tmp_path / "metres.npy"
    np.save(metres, np.load(cloud)["points"] / 1000.0)
    assert run("--recipe", str(RECIPE), "--shaft", str(metres), "--json") == 3
    assert json.loads(capsys.readouterr().out)["refused"]["code"] == "wrong_unit"


@pytest.mark.parametrize("name", ["absent.ply", "cut.ply", "other.stl"])
def test_unreadable(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if not name.startswith("absent"):
        (tmp_path / name).write_bytes(b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\n")
    assert run("--recipe", str(RECIPE), "--shaft", str(tmp_path / name), "--json") == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["error"]["code"] == "unreadable"
    assert name in captured.err


def test_bad_recipe_and_no_cloud(cloud: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "r.toml").write_text("[recipe]\nid = 3\n")
    assert run("--recipe", str(tmp_path / "r.toml"), "--shaft", str(cloud)) == 2
    assert run("--recipe", str(RECIPE)) == 2
    assert "no cloud" in capsys.readouterr().err
