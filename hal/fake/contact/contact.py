"""Studs against holes, quasi-static: which offsets are free, which wedge on the chamfer, and what that costs. Pure.

The shaft floats in x, y and rotation against the chuck's stiffness k (x and y in N/mm; rotation as a tangential N/mm
at the bolt circle). A contact c of stud i leaves the radial offset ``|d_c|`` free up to ``a_c``; beyond, the stud bends
with ``k_c``. The float u = (x, y, tangential), millimetres, is the minimum of the convex energy

    E(u) = 1/2 u' K u + 1/2 sum_c k_c max(|d_c - G_c u| - a_c, 0)^2

found by damped semi-smooth Newton steps, vectorised over heights and contacts. With F the lateral force of a contact
the axial one is F (tan phi + mu) / (1 - mu tan phi) on the way in, phi being the half angle of the touching cone
against the axis (0 on the cylinder); without friction the axial work is exactly the energy E.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MAX_STEPS = 40
TOLERANCE_N = 1e-7


@dataclass(frozen=True, slots=True)
class EntryProfile:
    """Radii of holes and studs (n,) and half angles, for the first few millimetres where cone meets cone."""

    hole_mm: Array
    chamfer_mm: Array
    stud_mm: Array
    tip_mm: Array
    tan_chamfer: float
    tan_lead_in: float

    @property
    def chamfer_depth_mm(self) -> Array:
        """(n,) axial depth of each chamfer."""
        return np.maximum(self.chamfer_mm - self.hole_mm, 0.0) / self.tan_chamfer

    @property
    def lead_in_mm(self) -> Array:
        """(n,) axial length of each stud's lead-in cone."""
        return np.maximum(self.stud_mm - self.tip_mm, 0.0) / self.tan_lead_in

    @property
    def full_depth_mm(self) -> float:
        """Insertion at which cylinder faces cylinder everywhere."""
        return float(np.max(self.chamfer_depth_mm + self.lead_in_mm))


@dataclass(frozen=True, slots=True)
class Contacts:
    """What may touch: arrays (m, c) over m heights and c contacts; `offset_mm` (m, c, 2), `arm_mm` (m, c, 2).

    `offset_mm` is stud minus hole, `arm_mm` the hole's place relative to the pattern's centre, `stud` (c,) the stud
    that a contact belongs to, `tan_phi` the slope of the touching cone (0 on a cylinder).
    """

    offset_mm: Array
    arm_mm: Array
    free_mm: Array
    tan_phi: Array
    stiffness_n_per_mm: Array
    stud: NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Float:
    """Result of `solve`: float (m, 3) in mm and lateral force (m, c) in newton."""

    float_mm: Array
    lateral_n: Array


def allowance(profile: EntryProfile, depth_mm: Array, *, edge_mm: float = 0.0) -> tuple[Array, Array]:
    """Radial offset (m, n) that is free at insertions `depth_mm` (m, n), and the slope tan phi of what touches.

    Least radial distance of the hole's (convex) and the stud's profile over the overlap: its minimum lies at a corner
    of one of them. Infinite where the stud is not in yet. The edge between cone and cylinder still counts as cone for
    `edge_mm`: the force peaks there, and a grid of that step then cannot miss it.
    """
    chamfer, lead = profile.chamfer_depth_mm, profile.lead_in_mm
    corners = np.stack(
        [np.zeros_like(depth_mm), depth_mm, np.broadcast_to(chamfer, depth_mm.shape), depth_mm - lead], axis=0
    )
    at = np.clip(corners, 0.0, np.maximum(depth_mm, 0.0))
    hole = profile.hole_mm + profile.tan_chamfer * np.maximum(chamfer - at, 0.0)
    stud = np.minimum(profile.tip_mm + profile.tan_lead_in * (depth_mm - at), profile.stud_mm)
    gap = hole - stud
    corner = np.argmin(gap, axis=0)
    free = np.take_along_axis(gap, corner[None], axis=0)[0]
    place = np.take_along_axis(at, corner[None], axis=0)[0]
    # Going deeper by ds either the hole's slope or the stud's lead-in closes in, or both cylinders slide.
    on_chamfer = (place < chamfer + edge_mm - 1e-12) & ((corner == 1) | (corner == 3))
    on_lead_in = (depth_mm - place < lead + edge_mm - 1e-12) & ((corner == 0) | (corner == 2))
    tan_phi = np.where(on_chamfer, profile.tan_chamfer, np.where(on_lead_in, profile.tan_lead_in, 0.0))
    inside = depth_mm > 0.0
    return np.where(inside, free, np.inf), np.where(inside, tan_phi, 0.0)


def axial_ratio(tan_phi: ArrayLike, friction: float, *, inwards: bool = True) -> Array:
    """Axial over lateral force on a cone; infinite at and beyond the wedging limit mu tan phi = 1.

    Outwards the friction turns: on the cylinder it pulls with mu.
    """
    slope = np.asarray(tan_phi, dtype=np.float64)
    mu = friction if inwards else -friction
    margin = 1.0 - mu * slope
    return np.where(margin > 1e-9, (slope + mu) / np.maximum(margin, 1e-9), np.inf)


def solve(contacts: Contacts, stiffness_n_per_mm: Array, circle_radius_mm: float) -> Float:
    """Equilibrium of the floating shaft for each height.

    `stiffness_n_per_mm` (3,): x, y and tangential at `circle_radius_mm`. Heights without contact cost nothing.
    """
    m, c = contacts.free_mm.shape
    floated, lateral = np.zeros((m, 3)), np.zeros((m, c))
    distance = np.linalg.norm(contacts.offset_mm, axis=2)
    touching = np.flatnonzero((distance > contacts.free_mm).any(axis=1))
    if touching.size == 0:
        return Float(floated, lateral)
    pile = _Pile(
        contacts.offset_mm[touching, :, 0],
        contacts.offset_mm[touching, :, 1],
        -contacts.arm_mm[touching, :, 1] / circle_radius_mm,
        contacts.arm_mm[touching, :, 0] / circle_radius_mm,
        contacts.free_mm[touching],
        contacts.stiffness_n_per_mm[touching],
        np.asarray(stiffness_n_per_mm, dtype=np.float64),
    )
    u = _newton(pile)
    floated[touching] = u
    lateral[touching] = pile.stiffness * np.maximum(pile.rest(u)[2] - pile.free, 0.0)
    return Float(floated, lateral)


@dataclass(frozen=True, slots=True)
class _Pile:
    """The touching heights by component, all (m, c): offsets, motion of each hole per tangential millimetre."""

    offset_x: Array
    offset_y: Array
    turn_x: Array
    turn_y: Array
    free: Array
    stiffness: Array
    held: Array

    def rest(self, u: Array) -> tuple[Array, Array, Array]:
        """Offsets left after the float `u` (m, 3): x, y and distance."""
        x = self.offset_x - u[:, :1] - self.turn_x * u[:, 2:]
        y = self.offset_y - u[:, 1:2] - self.turn_y * u[:, 2:]
        return x, y, np.sqrt(x * x + y * y)

    def energy(self, u: Array) -> Array:
        """(m,) energy E(u)."""
        over = np.maximum(self.rest(u)[2] - self.free, 0.0)
        return np.asarray(0.5 * (u * u) @ self.held + 0.5 * np.sum(self.stiffness * over * over, axis=1))

    def slopes(self, u: Array) -> tuple[Array, Array, Array]:
        """Gradient (m, 3), its contact part (m, 3) and the generalised Hessian (m, 3, 3)."""
        x, y, length = self.rest(u)
        length = np.maximum(length, 1e-12)
        over = np.maximum(length - self.free, 0.0)
        nx, ny = x / length, y / length
        force = self.stiffness * over
        push = _onto(force * nx, force * ny, self.turn_x, self.turn_y)
        # Along the normal the full stiffness, across it the share over / length of a cable under tension.
        active = np.where(over > 0.0, self.stiffness, 0.0)
        across = active * over / length
        xx, xy, yy = (
            across + (active - across) * nx * nx,
            (active - across) * nx * ny,
            across + (active - across) * ny * ny,
        )
        column_x = _onto(xx, xy, self.turn_x, self.turn_y)
        column_y = _onto(xy, yy, self.turn_x, self.turn_y)
        column_t = _onto(
            xx * self.turn_x + xy * self.turn_y, xy * self.turn_x + yy * self.turn_y, self.turn_x, self.turn_y
        )
        hessian = np.diag(self.held) + np.stack([column_x, column_y, column_t], axis=2)
        return u * self.held - push, push, hessian

    def at(self, rows: NDArray[np.intp]) -> _Pile:
        """Some of the heights."""
        return _Pile(
            self.offset_x[rows],
            self.offset_y[rows],
            self.turn_x[rows],
            self.turn_y[rows],
            self.free[rows],
            self.stiffness[rows],
            self.held,
        )


def _onto(x: Array, y: Array, turn_x: Array, turn_y: Array) -> Array:
    """(m, 3) sums over the contacts of forces (m, c), as force x, y and tangential force."""
    return np.stack([x.sum(axis=1), y.sum(axis=1), (x * turn_x + y * turn_y).sum(axis=1)], axis=1)


def _newton(pile: _Pile) -> Array:
    u = np.zeros((len(pile.free), 3))
    open_ = np.arange(len(u))
    here = pile
    for _ in range(MAX_STEPS):
        gradient, push, hessian = here.slopes(u[open_])
        unsolved = np.abs(gradient).max(axis=1) > TOLERANCE_N * (1.0 + np.abs(push).max(axis=1))
        if not unsolved.any():
            break
        step = np.asarray(-np.linalg.solve(hessian, gradient[..., None])[..., 0], dtype=np.float64)
        u[open_] += step * _damping(here, u[open_], step, gradient)[:, None]
        if unsolved.sum() < 0.7 * len(open_):
            open_ = open_[unsolved]
            here = pile.at(open_)
    return u


def _damping(pile: _Pile, u: Array, step: Array, gradient: Array) -> Array:
    """(m,) share of the step, halved until the energy falls (Armijo)."""
    start = pile.energy(u)
    fall = np.sum(step * gradient, axis=1)
    share = np.ones(len(u))
    for _ in range(12):
        poor = pile.energy(u + share[:, None] * step) > start + 1e-4 * share * fall + 1e-12
        if not poor.any():
            break
        share[poor] *= 0.5
    return share
