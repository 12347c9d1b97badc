"""Point sets like those by which metrology institutes test fitting software: 8 to 50 points within 500 mm.

Each set draws a geometry (whole or a small part of it, sharp, flat), a pattern of points (anywhere, rings, few), a
form error (none, noise, lobes, a step, a bend) and a place, all at random.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.vision.fit.reference import Array, orientation

REACH_MM = 500.0
PARTS = {
    "line": ("long", "short"),
    "plane": ("wide", "strip", "small"),
    "circle": ("full", "arc"),
    "sphere": ("full", "cap", "band"),
    "cylinder": ("full", "arc", "short", "patch", "long"),
    "cone": ("full", "arc", "short", "patch", "sharp", "flat"),
}
SHARES = (0.02, 0.2, 1.0)
"""Greatest form error as a share of the height of the arc over its chord: up to one, where little is left to see."""
ERRORS = ("none", "noise", "lobes", "step", "bend")


@dataclass(frozen=True)
class Drawn:
    """Points (N, 3), the element they were made from (point, direction, radius there, half angle), and what it is."""

    kind: str
    family: str
    points: Array
    truth: tuple[Array, Array | None, float, float]


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def spread(rng: np.random.Generator, count: int, low: float, high: float) -> Array:
    """Numbers over an interval with both ends among them, in any order."""
    return rng.permutation(np.concatenate([[low, high], rng.uniform(low, high, count - 2)]))


def grid(rng: np.random.Generator, pattern: str, turn: float, *, whole: bool) -> tuple[Array, Array]:
    """Angles over an arc and places from -1 to 1 along the axis."""
    if pattern == "rings":
        rings, each = int(rng.integers(2, 6)), int(rng.integers(4, 11))
        ring = np.linspace(0.0, turn, each, endpoint=not whole)
        return np.tile(ring, rings), np.repeat(np.linspace(-1.0, 1.0, rings), each)
    count = 8 if pattern == "few" else int(rng.integers(8, 51))
    return spread(rng, count, 0.0, turn * (1.0 - 1.0 / count if whole else 1.0)), spread(rng, count, -1.0, 1.0)


def form(rng: np.random.Generator, error: str, size: float, angle: Array, along: Array) -> Array:
    """Deviations along the normal, at most about `size`."""
    noise = rng.standard_normal(len(angle)) * size
    if error == "lobes":
        wave = np.cos(rng.integers(2, 12) * angle + rng.uniform(0, 6.3)) * (1.0 + rng.uniform(-0.5, 0.5) * along)
        return size * wave + 0.1 * noise
    if error == "step":
        return size * np.sign(along - rng.uniform(-0.8, 0.8)) + 0.1 * noise
    if error == "bend":
        return size * (along**2 - 0.4) * rng.choice([-1.0, 1.0]) + 0.1 * noise
    return noise if error == "noise" else 0.0 * noise


def draw(kind: str, rng: np.random.Generator, *, exact: bool = False) -> Drawn:
    """One set, without form error where `exact`."""
    part = str(rng.choice(PARTS[kind]))
    pattern = str(rng.choice(["anywhere", "rings", "few"]))
    error = "none" if exact else str(rng.choice(ERRORS))
    make = {"line": flat, "plane": flat, "sphere": ball}.get(kind, round_about)
    shape = make(kind, part, pattern, rng)
    size = min(log_uniform(rng, 1e-4, 0.3), float(rng.choice(SHARES)) * shape.sagitta)
    local = shape.points + form(rng, error, size, shape.angle, shape.along)[:, None] * shape.normals
    if kind in ("line", "circle") and error != "none":  # the second way off the element
        third = np.array([0.0, 0.0, 1.0])
        across = np.broadcast_to(third, local.shape) if kind == "circle" else np.cross(third, shape.normals)
        local = local + form(rng, "noise", size, shape.angle, shape.along)[:, None] * across
    frame = orientation(rng) if rng.uniform() < 0.8 else np.eye(3)[rng.permutation(3)]
    points = (local - local.mean(axis=0)) @ frame
    room = max(REACH_MM - float(np.abs(points).max()), 0.0) * float(rng.choice([0.0, 0.1, 1.0]))
    shift = rng.uniform(-room, room, 3)
    origin = shift - local.mean(axis=0) @ frame
    direction = None if kind == "sphere" else frame[2]
    return Drawn(kind, f"{part} {pattern} {error}", points + shift, (origin, direction, shape.radius, shape.half))


@dataclass(frozen=True)
class Shape:
    """Perfect points with their normals, in a frame whose third axis is the element's."""

    points: Array
    normals: Array
    angle: Array
    along: Array
    sagitta: float
    radius: float = 0.0
    half: float = 0.0


def flat(kind: str, part: str, pattern: str, rng: np.random.Generator) -> Shape:
    size = {"short": 3.0, "small": 3.0}.get(part, 280.0) * rng.uniform(0.2, 1.0)
    angle, along = grid(rng, pattern, 2.0 * np.pi, whole=True)
    if kind == "line":
        out = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
        return Shape(size * along[:, None] * np.array([0.0, 0.0, 1.0]), out, angle, along, size)
    width = size * (0.02 if part == "strip" else 1.0)
    points = np.column_stack([size * along, width * np.cos(angle), 0.0 * angle])
    return Shape(points, np.broadcast_to([0.0, 0.0, 1.0], points.shape), angle, along, width)


def ball(_: str, part: str, pattern: str, rng: np.random.Generator) -> Shape:
    cap = np.radians(log_uniform(rng, 5.0, 45.0))
    radius = log_uniform(rng, 1.0, 280.0 if part == "full" else 600.0)
    angle, along = grid(rng, pattern, 2.0 * np.pi, whole=True)
    z = {"cap": 1.0 - (1.0 - np.cos(cap)) * 0.5 * (along + 1.0), "band": 0.2 * along}.get(part, 0.98 * along)
    rho = np.sqrt(1.0 - z * z)
    out = np.column_stack([rho * np.cos(angle), rho * np.sin(angle), z])
    return Shape(radius * out, out, angle, along, radius * ((1.0 - np.cos(cap)) if part == "cap" else 0.2), radius)


def round_about(kind: str, part: str, pattern: str, rng: np.random.Generator) -> Shape:
    """Circle, cylinder or cone."""
    partial = part in ("arc", "patch")
    radius = log_uniform(rng, 1.0, 600.0 if partial else 280.0)
    turn = np.radians(log_uniform(rng, 10.0, 120.0)) if partial else 2.0 * np.pi
    angle, along = grid(rng, pattern, turn, whole=not partial)
    out = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    rise = radius * (1.0 - np.cos(0.5 * turn)) if partial else radius
    if kind == "circle":
        return Shape(radius * out, out, angle, along, rise, radius)
    slender = {"short": (0.05, 0.3), "patch": (0.05, 0.3), "long": (2.0, 10.0)}.get(part, (0.3, 2.0))
    length = min(log_uniform(rng, *slender) * radius, 280.0)
    degrees = {"sharp": (0.1, 3.0), "flat": (70.0, 89.0)}.get(part, (3.0, 60.0))
    half = np.radians(log_uniform(rng, *degrees)) if kind == "cone" else 0.0
    # from small end to large end along the generator, never beyond the apex
    reach = 0.9 * radius / np.sin(half) if half > 0.0 else np.inf
    up = 0.5 * min(length, reach) * along
    points = out * (radius + up * np.sin(half))[:, None] + np.column_stack([0 * up, 0 * up, up * np.cos(half)])
    normals = out * np.cos(half) - np.array([0.0, 0.0, np.sin(half)])
    sagitta = min(rise * np.cos(half), 0.5 * min(length, reach))
    return Shape(points, normals, angle, along, sagitta, radius, half)
