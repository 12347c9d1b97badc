"""The benchmarks: scenes repeat, the library recipe measures, errors are counted, the document follows the figures."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import with_open3d
from tests.benchmarks.errors import errors
from tests.benchmarks.pipelines import ROOT
from tests.benchmarks.report import plot, report
from tests.benchmarks.scenes import Scene, plain, stressed, studs
from tests.benchmarks.timing import exponent, ratios
from tests.benchmarks.worker import laid_out, ours

FIGURES = ROOT / "docs" / "figures" / "bench.json"


@pytest.fixture(scope="module")
def scene() -> Scene:
    return plain(100_000, 4)


def test_a_scene_is_drawn_from_its_seed_and_has_the_points_asked_for(scene: Scene) -> None:
    assert np.array_equal(plain(100_000, 4).cloud, scene.cloud, equal_nan=True)
    assert not np.array_equal(plain(100_000, 5).cloud, scene.cloud, equal_nan=True)
    assert scene.points == pytest.approx(100_000, rel=0.01)
    assert studs(30_000, 1).points == pytest.approx(30_000, rel=0.02)


def test_a_stressed_scene_misses_a_fifth_of_the_view_and_holes_in_it() -> None:
    scenes = [stressed(seed) for seed in range(3)]
    for one in scenes:
        # a fifth in patches, 2 % by chance
        assert 0.21 < np.isnan(one.cloud[..., 0]).mean() < 0.35
        assert one.seen.sum() >= 0.5 * one.part.count
    assert any(not one.seen.all() for one in scenes)
    assert len({one.part.count for one in scenes}) > 1


@pytest.mark.parametrize("options", [{}, {"sor": True}, {"cut": True}, {"wall": True}], ids=str)
def test_the_library_recipe_finds_every_hole(scene: Scene, options: dict[str, bool]) -> None:
    found = errors(with_open3d.measure(scene.cloud, scene.job(), **options), scene)
    assert len(found.centres_um) == found.seen == scene.part.count
    # pixels are 1 mm apart: an outline is known to a fraction of that, the walls with their hundreds of points better
    assert np.sqrt(np.mean(found.centres_um**2)) < (60.0 if "wall" in options else 200.0)
    assert found.normal_deg < 0.002
    assert abs(found.clocking_deg) < 0.05


@pytest.mark.parametrize("layout", ["grid", "list"])
def test_errors_are_those_of_the_pose(scene: Scene, layout: str) -> None:
    result = ours(laid_out(scene.cloud, layout), scene.part)
    right = errors(result, scene)
    assert len(right.centres_um) == scene.part.count
    assert right.gross == 0
    assert abs(right.clocking_deg) < 0.003
    centre = np.array(result["centres"][0]) + 0.4 * scene.truth[:3, 0]
    wrong = errors(result | {"centres": [centre.tolist(), *result["centres"][1:]]}, scene)
    assert wrong.gross == 1
    assert wrong.centres_um[0] == pytest.approx(400.0, abs=50.0)


def test_a_refusal_is_counted_and_not_measured(scene: Scene) -> None:
    refused = errors(ours(scene.cloud / np.float32(1000.0), scene.part), scene)
    assert refused.refused.startswith("wrong_unit")
    assert len(refused.centres_um) == 0


def test_the_fastest_rival_is_the_one_on_the_same_view() -> None:
    passes = {"ours": 10.0, "PCL": 40.0, "Open3D": 90.0, "PCL + SOR": 200.0, "PCL, 2 threads": 25.0}
    passes |= {"ours, view cut": 4.0, "PCL, view cut": 8.0}
    found = ratios({label: {"passes": value} for label, value in passes.items()})
    assert found["without_sor"] == {"fastest": "PCL", "ratio": 0.25}
    assert found["with_sor"] == {"fastest": "PCL + SOR", "ratio": 0.05}
    assert found["without_sor_2_threads"] == {"fastest": "PCL, 2 threads", "ratio": 0.4}
    assert found["cut_without_sor"] == {"fastest": "PCL, view cut", "ratio": 0.5}
    assert "cut_with_sor" not in found


def test_the_exponent_of_a_power_is_that_power() -> None:
    assert exponent([1.0, 2.0, 8.0], [3.0, 3.0 * 2.0**1.5, 3.0 * 8.0**1.5]) == pytest.approx(1.5)


def test_document_and_plot_follow_the_figures() -> None:
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    assert (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8") == report(figures)
    assert (FIGURES.parent / "bench_time.svg").read_text(encoding="utf-8") == plot(figures)


def test_a_missing_part_is_left_out() -> None:
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    assert "## Stress" not in report({"run": figures["run"]})
    assert "## A whole run" in report({"run": figures["run"]})


def test_what_pcl_needs_is_asked_for_in_one_line(tmp_path: Path) -> None:
    script = ROOT / "tests" / "benchmarks" / "check-pcl.sh"
    done = subprocess.run(["/bin/sh", script], env={"PATH": str(tmp_path)}, capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("  sudo apt-get install -y --no-install-recommends g++ libpcl-dev")
