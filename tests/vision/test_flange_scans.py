"""Real scans of a robot's tool flange; they lie beside the project, not in it."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.cli import measure as command
from cellctl.recipe import load_recipe
from cellctl.vision.cloud import load_cloud
from cellctl.vision.measure import measure_part
from cellctl.vision.part import Part, PartMeasurement

SCANS = Path(__file__).parents[3] / "shared" / "data" / "flange_scans"
RECIPE = Path(__file__).parents[2] / "recipes" / "flange_iso9409_50_4.toml"
pytestmark = pytest.mark.skipif(not SCANS.is_dir(), reason="the scans are not beside this project")

PART = load_recipe(RECIPE).part("shaft")
VARIANTS = {
    "recipe": PART,
    "without rims": replace(PART, face_inner_diameter_mm=None, face_outer_diameter_mm=None),
    "nominal thread sizes": replace(PART, diameter_mm=(8.0, 6.0, 6.0, 6.0, 6.0)),
    "one size": replace(PART, diameter_mm=(5.0,) * 5),
    "key hole last": replace(
        PART, angles_deg=(45.0, 135.0, 225.0, 315.0, 0.0), diameter_mm=(5.0, 5.0, 5.0, 5.0, 6.0), index_feature=4
    ),
}


def measured(name: str, part: Part) -> PartMeasurement:
    return measure_part(load_cloud(SCANS / name).points, part)


@pytest.mark.parametrize("variant", VARIANTS)
def test_five_holes_on_fifty_millimetres(variant: str) -> None:
    part = VARIANTS[variant]
    first, fourth = measured("01_tool_valid.ply", part), measured("04_tool_valid.ply", part)
    drawing = measured("flange_franka.pcd", part)
    for scan in (first, fourth, drawing):
        assert scan.found == 5 and not scan.clocking_free
        assert abs(scan.circle_diameter_mm - 50.0) < 0.15
    for scan in (first, fourth):
        assert scan.face.normal @ scan.face.point_mm < 0.0  # towards the scanner at the origin
    assert drawing.face.normal[2] > 0.9999  # the body lies below its face at z = 3
    turned = first.T_frame_part[:3, :3].T @ fourth.T_frame_part[:3, 0]
    assert abs(np.degrees(np.arctan2(turned[1], turned[0]))) < 0.15


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
