"""Studs of random joints against the bound of the same clouds, whatever the recipe leaves out and the studs look like.

`stud_campaign` does the same over hundreds of clouds.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.vision.measure import measure_part
from cellctl.vision.part import Part, Refused
from cellctl.vision.thread import fit_thread
from tests.vision.bound_studs import scene_bound
from tests.vision.stud_campaign import Tally, compare, flange, interval, one_stud
from tests.vision.stud_scene import Errors, Scene, random_scene, render, spoil, trace
from tests.vision.thread_scene import Bolt, close_up

SLANT = Errors(growth=1.0, steep_deg=80.0)


def measured(scene: Scene, part: Part, seed: int) -> Tally:
    """What one cloud of the scene gives for the recipe `part`."""
    tally = Tally(clouds=1, studs=len(scene.bolts))
    traced = trace(scene)
    cloud, good = spoil(scene, *traced, np.random.default_rng(seed))
    compare(scene, measure_part(cloud, part), scene_bound(scene, *traced, good=good), tally)
    return tally


def within(tally: Tally, most: float) -> None:
    """Every stud found, none invented, each rms within `most` bounds unless chance alone may have lifted it there."""
    assert (tally.found, tally.invented, tally.refused) == (tally.studs, 0, []), tally.summary()
    for name, values in tally.z.items():
        assert interval(np.array(values))["low"] < most, (name, tally.summary())
    assert interval(np.array(tally.z["place"]))["rms"] < most


@pytest.mark.parametrize("points", [100_000, 300_000])
def test_random_joints_within_the_bounds(points: int) -> None:
    tally = Tally()
    for seed in range(6):
        flange(seed, points, tally)
    within(tally, 1.25)


def test_close_ups_within_the_bounds() -> None:
    tally = Tally()
    for seed in range(12):
        one_stud(seed, tally)
    assert tally.found == tally.studs, tally.summary()
    for name in ("radius", "pitch"):
        assert interval(np.array(tally.z[name]))["rms"] < 2.0, (name, tally.summary())


@pytest.mark.parametrize(
    "unknown", [{"length_mm": None}, {"thread": None}, {"diameter_mm": None, "thread": None, "length_mm": None}]
)
def test_sizes_that_the_recipe_leaves_out_are_estimated(unknown: dict[str, None]) -> None:
    scene = random_scene(np.random.default_rng(52), 200_000, errors=SLANT)
    within(measured(scene, replace(scene.part, **unknown), 1), 1.6)


@pytest.mark.parametrize(
    "form",
    [{"crest": 0.02}, {"crest": 0.2}, {"round_mm": 0.05, "crest": 0.15}, {"lead_in": 50.0}, {"fall": 0.577},
     {"dome_mm": 9.0}, {"shank": 6.0}, {"depth": 0.5413}],
    ids=["sharp", "blunt", "rounded", "no lead-in", "30 degrees", "dome", "shank", "shallow"],
)  # fmt: skip
def test_studs_of_other_forms_stand_where_they_are(form: dict[str, float]) -> None:
    scene = random_scene(np.random.default_rng(53), 150_000, errors=SLANT)
    scene = replace(scene, bolts=tuple(replace(bolt, **form) for bolt in scene.bolts))
    tally = measured(scene, scene.part, 2)
    assert (tally.found, tally.invented) == (tally.studs, 0)
    assert interval(np.array(tally.z["place"]))["rms"] < 1.3


def test_studs_that_lean_more_than_drawings_allow() -> None:
    tally = Tally()
    for seed in range(54, 58):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng, 200_000, errors=SLANT)
        scene = replace(scene, leans=np.radians(rng.normal(0.0, 0.3, scene.leans.shape)))
        traced = trace(scene)
        cloud, good = spoil(scene, *traced, np.random.default_rng(3))
        tally.clouds, tally.studs = tally.clouds + 1, tally.studs + len(scene.bolts)
        compare(scene, measure_part(cloud, scene.part), scene_bound(scene, *traced, good=good), tally)
    within(tally, 1.4)


def test_plain_pins_that_are_asked_for() -> None:
    scene = random_scene(np.random.default_rng(55), 200_000, errors=SLANT)
    plain = replace(scene, bolts=tuple(replace(bolt, depth=0.0) for bolt in scene.bolts))
    found = measure_part(render(plain, np.random.default_rng(4)), replace(scene.part, thread=None))
    assert found.found == scene.part.count
    assert found.features[0].thread is None
    assert found.features[0].radius_mm == pytest.approx(scene.bolts[0].radius, abs=0.025)


def test_a_list_of_points_in_any_frame() -> None:
    rng = np.random.default_rng(56)
    scene = random_scene(rng, 150_000, errors=SLANT)
    traced = trace(scene)
    cloud, good = spoil(scene, *traced, rng)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, [400.0, -250.0, 90.0]
    loose = cloud[np.isfinite(cloud[..., 0])] @ turn.T + T[:3, 3]
    tally = Tally(studs=len(scene.bolts))
    moved = replace(scene, T_scanner_part=T @ scene.T_scanner_part)
    compare(moved, measure_part(loose, scene.part), scene_bound(scene, *traced, good=good), tally)
    assert (tally.found, tally.invented) == (tally.studs, 0)
    assert interval(np.array(tally.z["place"]))["rms"] < 1.5


def wrong_parts(part: Part) -> dict[str, Part]:
    """The same part with one thing drawn otherwise."""
    thread = part.thread
    assert thread is not None and part.length_mm is not None
    return {
        "hand": replace(part, thread=replace(thread, hand="left" if thread.hand == "right" else "right")),
        "starts": replace(part, thread=replace(thread, starts=3 - thread.starts)),
        "pitch": replace(part, thread=replace(thread, pitch_mm=0.8 * thread.pitch_mm)),
        "size": replace(part, thread=replace(thread, major_diameter_mm=thread.major_diameter_mm + 1.0)),
        "length": replace(part, length_mm=1.2 * part.length_mm + 2.0),
        "count": replace(part, angles_deg=part.angles_deg[:-1], diameter_mm=(part.diameter_mm or ())[:-1]),
    }


def test_another_part_is_refused() -> None:
    scene = random_scene(np.random.default_rng(57), 150_000, errors=SLANT)
    cloud = render(scene, np.random.default_rng(5))
    for name, part in wrong_parts(scene.part).items():
        with pytest.raises(Refused) as refused:
            measure_part(cloud, part)
        assert refused.value.code in ("thread_wrong", "wrong_part", "features_missing", "pattern_ambiguous"), name


def test_the_axis_of_a_third_of_a_stud() -> None:
    """120 degrees of arc, seen from the side."""
    bolt = Bolt(radius=3.9471, pitch=1.2537)
    for seed in range(4):
        points, eye = close_up(bolt, np.random.default_rng(seed), points=8000)
        points = points[np.abs(np.arctan2(points[:, 1], points[:, 0])) < np.radians(60.0)]
        found = fit_thread(points, viewpoint=eye)
        assert np.degrees(np.hypot(*found.direction[:2])) < 0.05
        assert found.thread.radius_mm == pytest.approx(bolt.radius, abs=0.03)


PROGRAM = """
import hashlib, numpy as np
from tests.vision.stud_scene import Errors, random_scene, render
from cellctl.vision.measure import measure_part
rng = np.random.default_rng(58)
scene = random_scene(rng, 150_000, errors=Errors(correlation_px=3.0))
found = measure_part(render(scene, rng), scene.part)
data = found.T_frame_part.tobytes() + found.covariance.tobytes()
print(hashlib.sha256(data + repr(found.features[0].thread).encode()).hexdigest())
"""


def test_the_number_of_threads_changes_no_bit() -> None:
    root = Path(__file__).parents[2]
    seen = set()
    for threads in ("1", "2"):
        numbers = {"OMP_NUM_THREADS": threads, "OPENBLAS_NUM_THREADS": threads}
        environment = os.environ | numbers | {"PYTHONPATH": str(root)}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, cwd=root, capture_output=True, text=True, check=True
        )
        seen.add(done.stdout)
    assert len(seen) == 1
