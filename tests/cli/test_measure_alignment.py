"""Two clouds of the twin's parts: the alignment in the document agrees with where the parts truly are."""

from __future__ import annotations

import json
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import pytest

from cellctl.cli import measure as command
from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant, TwinSettings
from hal.fake.scene.picture import picture_of
from hal.fake.scene.render import render

ROOT = Path(__file__).parents[2]
WORDS = ["measure", "--recipe", str(ROOT / "recipes" / "lpt_shaft_36.toml"), "--json"]
CALIBRATION = ["--calibration", str(ROOT / "deploy" / "calibration.fake.toml")]


@pytest.fixture(scope="module")
def plant() -> Plant:
    plant = Plant(JointGeometry(angles_deg=tuple(10.0 * i for i in range(36))), TwinSettings(seed=5))
    plant.advance(0.0)
    return plant


@pytest.fixture(scope="module")
def clouds(plant: Plant, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both parts, in the scanner's frame and carried into the cell by the camera's true pose."""
    folder = tmp_path_factory.mktemp("clouds")
    for view in ("rotor", "shaft"):
        plant.camera = view
        cloud = render(picture_of(plant, view, 200_000), 5)
        T = plant.T_cell_camera(view)
        np.save(folder / f"{view}.npy", cloud)
        np.save(folder / f"{view}_cell.npy", (cloud @ T[:3, :3].T + T[:3, 3]).astype(np.float32))
    return folder


def run(*words: str) -> int:
    parser = ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return command.run(parser.parse_args([*WORDS, *words]))


def true_turn_deg(plant: Plant) -> float:
    """Turn of the shaft, modulo a pitch, that lays its pattern on the rotor's."""
    shaft, rotor = plant.T_cell_shaft(), plant.T_cell_rotor()
    angle = [np.degrees(np.arctan2(T[1, 0], T[0, 0])) for T in (shaft, rotor)]
    return float((angle[1] - angle[0] + 5.0) % 10.0 - 5.0)


@pytest.mark.parametrize("frame", ["scanner", "cell"])
def test_alignment(frame: str, plant: Plant, clouds: Path, capsys: pytest.CaptureFixture[str]) -> None:
    suffix, calibration = ("", CALIBRATION) if frame == "scanner" else ("_cell", [])
    files = ["--rotor", str(clouds / f"rotor{suffix}.npy"), "--shaft", str(clouds / f"shaft{suffix}.npy")]
    assert run(*files, *calibration) == 0
    document = json.loads(capsys.readouterr().out)
    found = document["alignment"]
    assert found["theta_deg"] == pytest.approx(true_turn_deg(plant), abs=0.02)
    turn = np.radians(found["theta_deg"])
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ plant.T_cell_shaft()[:2, 3]
    move = plant.T_cell_rotor()[:2, 3] - turned  # the table turns about the cell's z axis
    assert np.hypot(found["x_mm"] - move[0], found["y_mm"] - move[1]) < 0.05
    assert len(found["clearance_mm"]) == 36 and min(found["clearance_mm"]) > 0.05
    assert found["p_insert"] > 0.9 and 0.0 < found["sigma_theta_deg"] < 0.05
    assert document["rotor"]["features"][0]["thread"]["pitch_mm"] == pytest.approx(1.0, abs=0.01)


def test_two_views_without_their_calibration_are_refused(clouds: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--rotor", str(clouds / "rotor.npy"), "--shaft", str(clouds / "shaft.npy")) == 3
    assert json.loads(capsys.readouterr().out)["refused"]["code"] == "frames_disagree"
