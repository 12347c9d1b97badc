"""What the shaft feels when studs touch their holes: float, lateral and axial forces of one way in. Quasi-static."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEVELS, LEVEL_MM = 8, 0.005
"""Entries are told apart in at most so many levels, no finer than that: an overlap is a few micrometres."""


@dataclass(frozen=True, slots=True)
class ContactModel:
    """What the shaft feels when a stud meets its hole.

    `lateral_n_per_mm` holds the shaft in x, y and tangentially at the bolt circle; `stud_n_per_mm` is a stud's
    bending; the chamfer makes `chamfer_deg` with the hole's axis. Beyond the chamfer cylinder slides on cylinder and
    only `friction` is left of the lateral force.
    """

    lateral_n_per_mm: float = 1000.0
    stud_n_per_mm: float = 15000.0
    friction: float = 0.15
    chamfer_deg: float = 45.0

    @property
    def axial_per_lateral(self) -> float:
        """Axial over lateral force while a stud wedges on the chamfer: (tan phi + mu) / (1 - mu tan phi)."""
        return (self.slope + self.friction) / (1.0 - self.friction * self.slope)

    @property
    def slope(self) -> float:
        """tan phi of the chamfer against the hole's axis."""
        return float(np.tan(np.radians(self.chamfer_deg)))


def entry_forces(
    offsets_mm: Array, jacobian: Array, clearance_mm: Array, lag_mm: Array, model: ContactModel
) -> tuple[Array, Array]:
    """Peak axial force (samples, n) on each stud and (samples,) of all together while the studs enter, newton.

    `lag_mm` (n,) is by how much later each stud enters, because the faces are tilted: only those that pass their edge
    wedge on it; studs that are in slide, and the later ones have the room of the cone left.
    """
    span = float(np.ptp(lag_mm))
    levels = int(np.clip(np.ceil(span / LEVEL_MM), 1, LEVELS))
    at = np.minimum((levels * (lag_mm - lag_mm.min()) / max(span, 1e-12)).astype(int), levels - 1)
    axial, total = np.zeros(offsets_mm.shape[:2]), np.zeros(len(offsets_mm))
    for level in np.unique(at):
        height = lag_mm[at == level].max()
        room = clearance_mm + model.slope * np.maximum(lag_mm - height, 0.0)
        ratio = np.where(at >= level, model.axial_per_lateral, model.friction)
        now = ratio * lateral_forces(offsets_mm, jacobian, room, model)
        axial, total = np.maximum(axial, now), np.maximum(total, now.sum(axis=1))
    return axial, total


def lateral_forces(offsets_mm: Array, jacobian: Array, clearance_mm: Array, model: ContactModel) -> Array:
    """Lateral force (samples, n) in newton on each stud once the shaft has floated to its equilibrium.

    The float v (x, y, turn) minimises half the energy of the shaft's lateral spring plus that of every overlapping
    stud, a convex problem; semi-smooth Newton with step control, all samples at once.
    """
    arm2 = float(np.mean(np.sum(jacobian[:, :, 2] ** 2, axis=1)))
    spring = model.lateral_n_per_mm * np.diag([1.0, 1.0, arm2])
    ks = model.stud_n_per_mm
    v = np.zeros((len(offsets_mm), 3))
    flat = jacobian.reshape(-1, 3)
    squares = np.einsum("iak,ial->ikl", jacobian, jacobian).reshape(-1, 9)

    def state(at: Array) -> tuple[Array, Array, Array, Array]:
        e = offsets_mm + (at @ flat.T).reshape(offsets_mm.shape)
        r = np.maximum(np.linalg.norm(e, axis=2), 1e-12)
        overlap = np.maximum(r - clearance_mm, 0.0)
        energy = 0.5 * np.sum(at @ spring * at, axis=1) + 0.5 * ks * np.sum(overlap**2, axis=1)
        return np.asarray(energy), e / r[:, :, None], r, overlap

    energy, unit, r, overlap = state(v)
    for _ in range(25):
        rows = unit[:, :, :1] * jacobian[:, 0] + unit[:, :, 1:] * jacobian[:, 1]
        gradient = v @ spring + ks * (overlap[:, None] @ rows)[:, 0]
        active = (overlap > 0).astype(np.float64)
        bend = active * overlap / r
        straight = np.swapaxes(rows * (active - bend)[:, :, None], 1, 2) @ rows
        hessian = spring + ks * (straight + (bend @ squares).reshape(-1, 3, 3))
        step = -np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        length = np.ones(len(v))
        for _ in range(6):
            trial = state(v + length[:, None] * step)
            worse = trial[0] > energy
            if not worse.any():
                break
            length = np.where(worse, 0.5 * length, length)
        v = v + length[:, None] * step
        energy, unit, r, overlap = state(v)
        if float(np.max(np.abs(step) * np.sqrt(np.diag(spring)))) < 1e-5 * np.sqrt(model.lateral_n_per_mm):
            break
    return np.asarray(ks * overlap)
