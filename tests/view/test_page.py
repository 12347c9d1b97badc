"""The page of measured parts: whole in itself, small enough, and true to what was measured."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from cellctl.view.cloud import NO_RESIDUAL, RESIDUAL_STEP_MM, chosen, packed
from cellctl.view.page import POINTS, ROUND_UM, Look, page
from cellctl.vision.measure import measure_part
from cellctl.vision.residuals import NONE, SURFACES, Residuals, residuals
from tests.vision.parts import FLANGE, SHAFT
from tests.vision.synthetic import View, pose_above, render

MOST_BYTES = 3_000_000


@cache
def look(pixels: int = 600) -> Look:
    """The large joint with hole 3 closed."""
    grid = render(View(SHAFT, pose_above(350.0), pixels=pixels, missing=(3,)), np.random.default_rng(5))
    return Look("shaft", measure_part(grid, SHAFT), SHAFT, grid, None, "a<b>.ply")


@cache
def written() -> str:
    return page([look()], np.random.default_rng(0), facts=[("recipe", "r & s")])


def data_of(html: str) -> list[dict[str, Any]]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    sides: list[dict[str, Any]] = json.loads(found[1])
    return sides


def seen_by(shown: Look) -> Residuals:
    flat = shown.points.reshape(-1, 3)
    return residuals(flat[np.isfinite(flat[:, 0])], shown.measured, shown.part)


def test_the_page_needs_nothing_from_outside() -> None:
    html = written()
    assert not re.search(r"https?:|//cdn|@import|url\(|src=|href=", html)
    scripts = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in html


def test_a_large_cloud_stays_below_three_megabytes() -> None:
    shown = look(1000)
    html = page([shown, replace(shown, side="rotor")], np.random.default_rng(0))
    assert len(html.encode()) < MOST_BYTES
    sides = data_of(html)
    assert [side["count"] for side in sides] == [POINTS // 2] * 2


def test_what_is_packed_is_what_was_seen() -> None:
    seen = seen_by(look())
    rows = chosen(seen, 50_000, np.random.default_rng(1))
    cloud = packed(seen, rows)
    numbers = np.frombuffer(base64.b64decode(cloud.points), dtype="<i2").reshape(-1, 4)
    surfaces = np.frombuffer(base64.b64decode(cloud.surfaces), dtype=np.uint8)
    assert len(numbers) == len(surfaces) == len(rows) == cloud.count == 50_000
    assert np.abs(numbers[:, :3] * cloud.step_mm - seen.local_mm[rows]).max() <= 0.51 * cloud.step_mm < 0.01
    off = seen.distance_mm[rows]
    assert np.array_equal(numbers[:, 3] == NO_RESIDUAL, np.isnan(off))
    known = np.isfinite(off)
    assert np.abs(numbers[known, 3] * RESIDUAL_STEP_MM - off[known]).max() < 0.51 * RESIDUAL_STEP_MM
    assert np.array_equal(surfaces == len(SURFACES), seen.surface[rows] == NONE)


@pytest.mark.parametrize("budget", [20_000, 120_000, 10**6])
def test_features_stay_dense(budget: int) -> None:
    seen = seen_by(look())
    rows = chosen(seen, budget, np.random.default_rng(2))
    at_feature = np.count_nonzero(seen.feature >= 0)
    kept = np.count_nonzero(seen.feature[rows] >= 0)
    assert len(rows) == len(np.unique(rows)) == min(budget, len(seen.surface))
    assert kept == min(at_feature, max(int(0.7 * budget), budget - (len(seen.surface) - at_feature)))


def test_a_cloud_of_features_alone_uses_the_whole_budget() -> None:
    seen = seen_by(look())
    alone = replace(seen, feature=np.zeros_like(seen.feature))
    assert len(chosen(alone, 30_000, np.random.default_rng(2))) == 30_000


def test_a_missing_feature_is_told_with_its_reason() -> None:
    html = written()
    assert "35 of 36 holes found" in html
    assert 'class="missing" data-index="3"' in html
    reason = look().measured.features[3].reason
    assert reason and html.count(reason.replace("'", "&#x27;")) == 2
    [side] = data_of(html)
    assert [each["index"] for each in side["features"] if not each["found"]] == [3]
    lost = side["features"][3]
    angle = np.radians(SHAFT.angles_deg[3])
    assert np.allclose(lost["centre"], 120.0 * np.array([np.cos(angle), np.sin(angle)]))
    assert lost["mouth"] == pytest.approx(4.95)


def test_numbers_of_the_table_are_those_of_the_measurement() -> None:
    first = look().measured.features[0]
    row = re.search(r'<tr data-index="0">(.*?)</tr>', written())
    assert row is not None
    x, y, radius, sigma, residual, points = (float(cell) for cell in re.findall(r"<td>(.*?)</td>", row[1]))
    assert np.hypot(x, y) == pytest.approx(120.0, abs=0.05)
    assert radius == pytest.approx(first.radius_mm, abs=1e-4)
    assert first.covariance_mm2 is not None
    assert sigma == pytest.approx(1000.0 * np.sqrt(np.trace(first.covariance_mm2)), abs=0.2)
    assert (residual, points) == (pytest.approx(1000.0 * first.residual_mm, abs=0.1), first.points)


def test_words_from_outside_are_no_markup() -> None:
    html = written()
    assert "a&lt;b&gt;.ply" in html and "a<b>" not in html
    assert "r &amp; s" in html


def test_alignment_stands_beside_both_sides() -> None:
    alignment = {"theta_deg": 0.0123, "x_mm": 1.5, "p_insert": 0.99, "clocking_free": True,
                 "clearance_mm": [0.11, 0.09], "clearance_hot_mm": [0.07, float("nan")]}  # fmt: skip
    html = page([look()], np.random.default_rng(0), alignment=alignment)
    assert "<h2>Alignment</h2>" in html and "0.0123 °" in html and "0.0900 mm" in html
    assert "<h2>Alignment</h2>" not in written()


def test_a_face_without_drawn_rims_ends_where_its_points_end() -> None:
    grid = render(View(FLANGE, pose_above(350.0), pixels=400, clutter=False), np.random.default_rng(6))
    bare = replace(FLANGE, face_inner_diameter_mm=None, face_outer_diameter_mm=None)
    html = page([Look("shaft", measure_part(grid, bare), bare, grid)], np.random.default_rng(0))
    [side] = data_of(html)
    assert np.allclose(side["face"], [50.0, 95.0], atol=2.0)


def test_script_and_page_speak_of_the_same_things() -> None:
    html = written()
    script = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)[0]
    told = html.replace(script, "")
    ids, names = re.findall(r'getElementById\("([\w-]+)"\)', script), re.findall(r"\bform\.([a-z]\w+)\.", script)
    assert len(set(ids)) >= 3 and len(set(names)) >= 6
    assert [each for each in ids if f'id="{each}"' not in told] == []
    assert [each for each in names if f'name="{each}"' not in told] == []
    [side] = data_of(html)
    assert set(re.findall(r"\bdata\.(\w+)", script)) <= set(side)
    surfaces = [*SURFACES, "unused"]
    assert f"const SURFACES = {json.dumps(surfaces)};" in script
    assert all(f'name="{each}"' in told for each in surfaces)
    assert f"const RANGES_UM = {json.dumps(list(ROUND_UM))};" in script


def test_the_same_cloud_gives_the_same_page() -> None:
    assert page([look()], np.random.default_rng(0), facts=[("recipe", "r & s")]) == written()
