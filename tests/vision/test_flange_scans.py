"""Real scans of a robot's tool flange; they lie beside the project, not in it."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cellctl.cli import measure as command
from cellctl.recipe import load_recipe
from cellctl.vision.cloud import load_cloud
from cellctl.vision.measure import measure_part
from cellctl.vision.part import Part, PartMeasurement, Refused

SCANS = Path(__file__).parents[3] / "shared" / "data" / "flange_scans"
RECIPE = Path(__file__).parents[2] / "recipes" / "flange_iso9409_50_4.toml"
pytestmark = pytest.mark.skipif(not SCANS.is_dir(), reason="the scans are not beside this project")

PART = load_recipe(RECIPE).part("shaft")
VARIANTS = {
    "recipe": PART,
    "without rims": replace(PART, face_inner_diameter_mm=None, face_outer_diameter_mm=None),
    "nominal thread sizes": replace(PART, diameter_mm=(8.0, 6.0, 6.0, 6.0, 6.0)),
    "one size": replace(PART, diameter_mm=(5.0,) * 5),
    "no sizes": replace(PART, diameter_mm=None),
    "key hole last": replace(
        PART, angles_deg=(45.0, 135.0, 225.0, 315.0, 0.0), diameter_mm=(5.0, 5.0, 5.0, 5.0, 6.0), index_feature=4
    ),
}


SCANNED = ("01_tool_valid.ply", "04_tool_valid.ply")


def points(name: str) -> np.ndarray:
    return load_cloud(SCANS / name).points


def measured(name: str, part: Part) -> PartMeasurement:
    return measure_part(points(name), part)


def nominal_rms_mm(scan: PartMeasurement) -> float:
    """Distance of the holes from their nominal places, root of the mean square."""
    return float(np.sqrt(2.0) * scan.quality["pattern_rms_mm"])


def turned_deg(first: PartMeasurement, second: PartMeasurement, frame: np.ndarray) -> float:
    """Clocking of the second against the first, whose frame `frame` (3, 3) carries into that of the second."""
    x = (frame @ first.T_frame_part[:3, :3]).T @ second.T_frame_part[:3, 0]
    return float(np.degrees(np.arctan2(x[1], x[0])))


@pytest.mark.parametrize("variant", VARIANTS)
def test_five_holes_on_fifty_millimetres(variant: str) -> None:
    part = VARIANTS[variant]
    first, fourth = (measured(name, part) for name in SCANNED)
    drawing = measured("flange_franka.pcd", part)
    for scan in (first, fourth, drawing):
        assert scan.found == 5 and not scan.clocking_free
        assert abs(scan.circle_diameter_mm - 50.0) < 0.1
        assert nominal_rms_mm(scan) < 0.2
    for scan in (first, fourth):
        assert scan.face.normal @ scan.face.point_mm < 0.0  # towards the scanner at the origin
    assert drawing.face.normal[2] > 0.9999  # the body lies below its face at z = 3
    assert abs(turned_deg(first, fourth, np.eye(3))) < 0.15


@pytest.mark.parametrize("name", SCANNED)
def test_another_frame_and_other_noise_change_little(name: str) -> None:
    cloud, whole = points(name).astype(np.float64), measured(name, PART)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        frame = Rotation.random(rng=rng).as_matrix()
        scan = measure_part((cloud + rng.normal(0.0, 0.03, cloud.shape)) @ frame.T, PART)
        assert scan.found == 5
        assert abs(scan.circle_diameter_mm - 50.0) < 0.1
        assert nominal_rms_mm(scan) < 0.2
        assert abs(turned_deg(whole, scan, frame)) < 0.15


@pytest.mark.parametrize("name", SCANNED)
def test_seven_points_in_ten_say_the_same(name: str) -> None:
    cloud, whole = points(name), measured(name, PART)
    scans = [measure_part(cloud[np.random.default_rng(seed).random(len(cloud)) < 0.7], PART) for seed in range(8)]
    turns = np.abs([turned_deg(whole, scan, np.eye(3)) for scan in scans])
    assert all(scan.found == 5 for scan in scans)
    assert np.median(turns) < 0.1 and turns.max() < 0.25
    assert np.median([abs(scan.circle_diameter_mm - 50.0) for scan in scans]) < 0.1
    assert np.median([nominal_rms_mm(scan) for scan in scans]) < 0.2


@pytest.mark.parametrize("name", SCANNED)
def test_what_is_cut_away_is_missed_and_never_turns_the_part(name: str) -> None:
    """A tenth of the points is cut out around one of them: a hole may go, and with the key hole the clocking."""
    cloud, whole = points(name), measured(name, PART)
    refused = 0
    for seed in range(12):
        about = cloud[np.random.default_rng(seed).integers(len(cloud))]
        distance = np.linalg.norm(cloud - about, axis=1)
        try:
            scan = measure_part(cloud[distance > np.quantile(distance, 0.1)], PART)
        except Refused:
            refused += 1
            continue
        assert scan.found >= 4
        assert abs(turned_deg(whole, scan, np.eye(3))) < 4.0 * scan.sigma_clocking_deg + 0.15
    assert refused <= 5


def test_the_key_hole_is_the_larger_one() -> None:
    for name in ("01_tool_valid.ply", "04_tool_valid.ply"):
        radii = [feature.radius_mm or 0.0 for feature in measured(name, PART).features]
        assert radii[0] > max(radii[1:]) + 0.2


def test_cad_points_give_the_drawing() -> None:
    scan = measured("flange_franka.pcd", PART)
    assert scan.circle_diameter_mm == pytest.approx(50.0, abs=0.01)
    assert scan.face.flatness_mm < 0.001
    assert np.allclose(scan.T_frame_part[:3, 3], [31.5, 31.5, 3.0], atol=0.01)


def arguments(*words: str) -> Namespace:
    parser = ArgumentParser()
    command.add_parser(parser.add_subparsers())
    return parser.parse_args(["measure", "--recipe", str(RECIPE), *words])


def test_command_on_a_scan(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    view = tmp_path / "view.html"
    scan = str(SCANS / "01_tool_valid.ply")
    assert command.run(arguments("--shaft", scan, "--json", "--view", str(view))) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["frame"] == "input"
    assert [feature["found"] for feature in document["shaft"]["features"]] == [True] * 5
    page = view.read_text(encoding="utf-8")
    assert "all 5 holes found" in page and "01_tool_valid.ply" in page
