"""Docking without a cell: forces of one insertion and the best pose, from truth alone. Pure, usable without asyncio."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hal.fake.contact.curve import force_curve, gap_grid
from hal.fake.contact.insertion import Dock, meeting
from hal.fake.frames import rotation_z

Array = NDArray[np.float64]

SHARPNESS = (4.0, 16.0, 64.0, 256.0)
NEWTON_STEPS = 6


@dataclass(frozen=True, slots=True)
class DockForces:
    """One insertion up to the spigot: per stud (n,) the peak axial force, and whether it went in."""

    peak_n: Array
    peak_total_n: float
    inserted: NDArray[np.bool_]

    @property
    def ok(self) -> bool:
        """All studs in, none above 10 N (the paper's two criteria)."""
        return bool(self.inserted.all() and self.peak_n.max() <= 10.0)


@dataclass(frozen=True, slots=True)
class PoseError:
    """Shaft's pose minus its best pose, about the rotor's axis; theta right-handed about cell z."""

    x_mm: float
    y_mm: float
    theta_deg: float


def dock_forces(dock: Dock) -> DockForces:
    """Insert until the spigot is about to engage, whatever the force: studs that jam carry what the column yields."""
    gaps, spigot = gap_grid(dock), dock.geometry.spigot_length_mm
    curve = force_curve(dock, gaps[gaps > spigot])
    left_mm = max(float(dock.motor_mm(dock.heights_mm(np.array([spigot])))[0] - curve.z_mm[-1]), 0.0)
    stall_n = curve.stall_n_per_mm * left_mm if curve.jammed.any() else 0.0
    return DockForces(
        peak_n=curve.stud_in_n.max(axis=0) + stall_n * curve.stall_share,
        peak_total_n=float(curve.in_n.max()) + stall_n,
        inserted=np.full(dock.geometry.count, not curve.jammed.any()),
    )


def pose_error(dock: Dock) -> PoseError:
    """How far the shaft is from where the worst stud has most clearance, when its studs are in.

    Least squares of the offsets over x, y, theta (closed form), then the smooth minimax.
    """
    geometry = dock.geometry
    entered = geometry.stud_length_mm - geometry.lead_in_mm - geometry.chamfer_depth_mm
    met = meeting(dock, dock.heights_mm(np.array([entered, 2.0 * geometry.spigot_length_mm])))
    depth = geometry.stud_length_mm - met.gap_mm
    mouth, tip = np.minimum(depth, geometry.chamfer_depth_mm), np.minimum(depth, geometry.hole_depth_mm)
    offset = np.concatenate([met.offset_mm(mouth), met.offset_mm(tip)]).reshape(-1, 2)
    arm = np.tile(met.hole_mm - dock.rotor.T_cell_rotor[:2, 3], (2, 1, 1)).reshape(-1, 2)
    radius = 0.5 * geometry.circle_diameter_mm
    design = np.zeros((len(offset), 2, 3))
    design[:, 0, 0] = design[:, 1, 1] = 1.0
    design[:, 0, 2], design[:, 1, 2] = -arm[:, 1] / radius, arm[:, 0] / radius
    normal = np.einsum("nij,nik->jk", design, design)
    best = _minimax(offset, design, np.linalg.solve(normal, np.einsum("nij,ni->j", design, offset)))
    return PoseError(-float(best[0]), -float(best[1]), -float(np.degrees(best[2] / radius)))


def _minimax(offset: Array, design: Array, start: Array) -> Array:
    """(3,) that makes the largest ``|offset - design u|`` least, from the log-sum-exp of their squares.

    Damped Newton steps on a convex function that becomes sharper; the last one is within 2 % of the maximum.
    """
    u = start

    def squares(at: Array) -> Array:
        rest = offset - design @ at
        return np.asarray(np.sum(rest * rest, axis=1))

    scale = max(float(squares(u).max()), 1e-18)
    gram = 2.0 * np.einsum("nij,nik->njk", design, design) / scale
    for sharpness in SHARPNESS:
        for _ in range(NEWTON_STEPS):
            rest = offset - design @ u
            slope = -2.0 * np.einsum("nij,ni->nj", design, rest) / scale
            weight = _softmax(sharpness * squares(u) / scale)
            gradient = weight @ slope
            spread = np.einsum("n,nj,nk->jk", weight, slope - gradient, slope - gradient)
            step = -np.linalg.solve(np.einsum("n,njk->jk", weight, gram) + sharpness * spread, gradient)
            value = _soft_maximum(squares(u) / scale, sharpness)
            while _soft_maximum(squares(u + step) / scale, sharpness) > value and np.abs(step).max() > 1e-9:
                step = 0.5 * step
            u = u + step
    return u


def _softmax(values: Array) -> Array:
    exponential = np.exp(values - values.max())
    return np.asarray(exponential / exponential.sum())


def _soft_maximum(values: Array, sharpness: float) -> float:
    top = float(values.max())
    return top + math.log(float(np.exp(sharpness * (values - top)).sum())) / sharpness


def at_best_pose(dock: Dock) -> Dock:
    """The same dock with the shaft moved to its best pose, by the smallest turn that brings every stud to a hole."""
    dock = _nearest_pairing(dock)
    for _ in range(2):
        error = pose_error(dock)
        dock = moved(dock, -error.x_mm, -error.y_mm, -error.theta_deg)
    return dock


def _nearest_pairing(dock: Dock) -> Dock:
    """Centred, and turned so that hole 0 meets one of the studs: the one where all others fit best.

    Turns that fit equally well (a pattern's own symmetry) are told apart by their size.
    """
    gap = np.array([0.5 * dock.geometry.stud_length_mm])
    met = meeting(dock, dock.heights_mm(gap))
    rotor = dock.rotor.T_cell_rotor[:2, 3]
    shift = rotor - met.centre_mm[0]
    dock = moved(dock, float(shift[0]), float(shift[1]), 0.0)
    studs = met.stud_mm[0] - rotor
    hole = dock.T_cell_shaft(dock.heights_mm(gap))[0, :3, :3] @ np.array([*dock.shaft.hole_mm[0], 0.0])
    turns = np.degrees(np.arctan2(studs[:, 1], studs[:, 0]) - np.arctan2(hole[1], hole[0]))
    turns = np.sort((turns + 180.0) % 360.0 - 180.0)
    turns = turns[np.argsort(np.abs(turns), kind="stable")]
    misses = np.array([_miss(moved(dock, 0.0, 0.0, float(turn)), gap) for turn in turns])
    good = np.flatnonzero(misses <= misses.min() + 0.5 * dock.geometry.clearance_mm)
    return moved(dock, 0.0, 0.0, float(turns[good[0]]))


def _miss(dock: Dock, gap: Array) -> float:
    met = meeting(dock, dock.heights_mm(gap))
    offset = met.stud_mm - met.hole_mm
    return float(np.sqrt(np.mean(np.sum(offset * offset, axis=2))))


def moved(dock: Dock, x_mm: float, y_mm: float, theta_deg: float) -> Dock:
    """The same dock with the shaft turned about the rotor's axis, then moved in x, y."""
    x, y = rotation_z(math.radians(theta_deg))[:2, :2] @ np.array(dock.offset_mm)
    return replace(dock, offset_mm=(float(x) + x_mm, float(y) + y_mm), offset_deg=dock.offset_deg + theta_deg)
