"""Clouds of another part than the recipe's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.vision.part import Part
from tests.vision.files.judge import Expect, File
from tests.vision.files.packing import Case, Rng, file_of, some_holes, some_studs
from tests.vision.files.scenes import (
    COARSE_SERIES,
    drawn_angles,
    hole_part,
    hole_scene,
    stud_part,
    stud_scene,
)


def other_count(rng: Rng) -> File:
    part = hole_part(rng, "equal") if rng.random() < 0.6 else stud_part(rng, "equal")
    n = part.count
    counts = [k for k in (n - 2, n - 1, n + 1, n + 2, 2 * n, n // 2 if n % 2 == 0 else 0) if k >= 3]
    room = np.pi * part.circle_diameter_mm / (1.3 * max(part.chamfer_diameter_mm or 0.0, *(part.diameter_mm or ())))
    counts = [k for k in counts if k < room] or [n - 1]
    count = int(rng.choice(counts))
    other = replace(
        part, angles_deg=drawn_angles(rng, count, "equal"), diameter_mm=(part.diameter_mm or ())[:1] * count
    )
    return another(rng, f"{count} for {n} features", part, other)


def another(rng: Rng, what: str, part: Part, other: Part, expect: Expect = "refused") -> File:
    """A cloud of `other` for the recipe of `part`."""
    scene = hole_scene(other, rng) if other.feature == "hole" else stud_scene(other, rng)
    return file_of(rng, what, scene, scene.grid if rng.random() < 0.5 else scene.points, expect, part=part)


def factor(rng: Rng, low: float, high: float) -> float:
    """Larger or smaller by a share between `low` and `high`."""
    share = 1.0 + float(rng.uniform(low, high))
    return share if rng.random() < 0.5 else 1.0 / share


def other_circle(rng: Rng) -> File:
    part = hole_part(rng) if rng.random() < 0.6 else stud_part(rng)
    by = factor(rng, 0.03, 0.12)
    return another(rng, "another bolt circle", part, replace(part, circle_diameter_mm=part.circle_diameter_mm * by))


def other_angles(rng: Rng) -> File:
    part = hole_part(rng, "unequal") if rng.random() < 0.6 else stud_part(rng, "unequal")
    other = replace(part, angles_deg=drawn_angles(rng, part.count, str(rng.choice(["equal", "unequal"]))))
    return another(rng, "other angles", part, other)


def other_hole_size(rng: Rng) -> File:
    part = hole_part(rng, str(rng.choice(["equal", "unequal"])))
    assert part.diameter_mm is not None
    size = part.diameter_mm[0] * factor(rng, 0.07, 0.3)
    shift = size - part.diameter_mm[0]
    mouth = None if part.chamfer_diameter_mm is None else part.chamfer_diameter_mm + shift
    other = replace(part, diameter_mm=(size,) * part.count, chamfer_diameter_mm=mouth)
    return another(rng, "another hole size", part, other)


def other_thread(rng: Rng) -> File:
    part = stud_part(rng)
    thread = part.thread
    assert thread is not None
    kind = int(rng.integers(4))
    if kind == 0:
        other = replace(part, thread=replace(thread, pitch_mm=thread.pitch_mm * float(rng.choice([0.5, 0.75, 1.25]))))
    elif kind == 1:
        other = replace(part, thread=replace(thread, hand="left" if thread.hand == "right" else "right"))
    elif kind == 2:
        other = replace(part, thread=replace(thread, starts=2))
    else:
        major = float(rng.choice([size for size in COARSE_SERIES if size != thread.major_diameter_mm]))
        other = replace(part, thread=replace(thread, major_diameter_mm=major), diameter_mm=(major,) * part.count)
    return another(rng, f"another thread: {('pitch', 'hand', 'starts', 'size')[kind]}", part, other)


def other_kind(rng: Rng) -> File:
    """Studs where the recipe has holes, holes where it has studs."""
    if rng.random() < 0.5:
        scene, part = some_studs(rng), some_holes(rng).part
        return file_of(rng, "studs for holes", scene, scene.grid, "refused", part=part)
    scene, part = some_holes(rng), some_studs(rng).part
    return file_of(rng, "holes for studs", scene, scene.grid, "refused", part=part)


def mirrored(rng: Rng) -> File:
    """A left-handed scan: no rigid motion explains it where angles or threads have a hand."""
    scene = hole_scene(hole_part(rng, "unequal"), rng) if rng.random() < 0.6 else some_studs(rng)
    flip = np.ones(3)
    flip[int(rng.integers(3))] = -1.0
    points = (scene.grid if rng.random() < 0.5 else scene.points) * flip
    return file_of(rng, "mirrored", scene, points, "refused")


OTHERS: tuple[Case, ...] = (
    other_count, other_circle, other_angles, other_hole_size, other_thread, other_kind, mirrored,
)  # fmt: skip
