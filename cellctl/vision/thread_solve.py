"""Robust least squares of threaded studs on the depth along each ray: own parameters per stud, shared ones for all.

Normal equations in arrow form (one small block a stud, a border for the shared parameters), solved by the Schur
complement, so that the cost is linear in points and studs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.thread_surface import OWN, SHARED, TIP, Array, Depths, Form, Rays, depths

MIN_SIGMA_MM = 1e-5
HELD_MM, HELD_ROUNDS = 1e-3, 5
"""The shared sizes stay at their start until the studs stand: freed at once, they may run off with the phases."""


@dataclass(frozen=True, slots=True)
class Priors:
    """One sigma of what is known beforehand; infinite where nothing is. `own` (OWN,) about zero slopes and about the
    start for the rest; `shared` (SHARED,) about the start."""

    own: Array
    shared: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """`own` (n, OWN), `shared` (SHARED,) with their type A covariances (n, OWN, OWN), (SHARED, SHARED).

    `residuals_mm` (N,) predicted minus measured depth; `weights` (N,) robust, 0 for what is no thread; `sigmas_mm` (N,)
    one sigma of each depth; `scores` (N, 2) influence of each point on its stud's x and y.
    """

    own: Array
    shared: Array
    own_covariance: Array
    shared_covariance: Array
    residuals_mm: Array
    weights: Array
    sigmas_mm: Array
    scores: Array
    depths: Depths


def solve(
    rays: Rays,
    own: Array,
    shared: Array,
    form: Form,
    priors: Priors,
    *,
    start_mm: float = 0.25,
    rounds: int = 14,
) -> Solution:
    """Iterate to convergence; the scale of the robust loss falls from `start_mm` to what the residuals show."""
    start_own, start_shared = own.copy(), shared.copy()
    scale = start_mm
    for turn in range(rounds):
        met = depths(rays, own, shared, form)
        weights, sigmas = weigh(met, scale)
        blocks = _Blocks.of(rays.stud, len(own), met, weights / sigmas**2)
        held = replace(priors, shared=np.minimum(priors.shared, HELD_MM)) if turn < HELD_ROUNDS else priors
        d_own, d_shared = blocks.step(own, shared, start_own, start_shared, held)
        d_own = np.clip(d_own, -0.3, 0.3)
        own, shared = own + d_own, shared + np.clip(d_shared, -0.1, 0.1)
        settled = float(np.abs(d_own[:, [0, 1, 4]]).max()) < 1e-4
        if turn > HELD_ROUNDS + 1 and settled:
            break
        scale = 0.5 * scale if turn < 3 else 0.0
    met = depths(rays, own, shared, form)
    weights, sigmas = weigh(met, 0.0)
    blocks = _Blocks.of(rays.stud, len(own), met, weights / sigmas**2)
    own_covariance, shared_covariance = blocks.covariance(priors)
    push = np.einsum("nk,n->nk", met.own, weights / sigmas**2 * np.nan_to_num(met.ahead_mm))
    scores = np.einsum("nkl,nl->nk", own_covariance[rays.stud, :2], push)
    return Solution(own, shared, own_covariance, shared_covariance, met.ahead_mm, weights, sigmas, scores, met)


def best_phase(rays: Rays, own: Array, shared: Array, form: Form, *, steps: int = 16, points: int = 4000) -> Array:
    """Phase (n,) in mm that fits each stud best among `steps` over one pitch, by a bounded cost on some points."""
    some = rays.take(np.arange(0, len(rays.stud), max(1, len(rays.stud) // points)))
    costs = []
    phases = own[:, 4] + shared[2] * np.arange(steps)[:, None] / steps
    for phase in phases:
        trial = own.copy()
        trial[:, 4] = phase
        met = depths(some, trial, shared, form)
        miss = np.minimum(np.abs(np.nan_to_num(met.ahead_mm, nan=9.0)) * met.cosine, 0.3)
        costs.append(np.bincount(some.stud, np.where(met.surface < TIP, miss, 0.0), len(own)))
    return np.asarray(phases[np.argmin(costs, axis=0), np.arange(len(own))])


def weigh(met: Depths, scale_mm: float) -> tuple[Array, Array]:
    """Tukey weights (N,) and one sigma (N,) of each depth: noise that grows with one over the cosine of incidence.

    Its scale is the robust residual of each kind of surface, or `scale_mm` where that is larger (while converging).
    """
    residual = np.where(np.isfinite(met.ahead_mm), met.ahead_mm, np.inf)
    cosine = np.maximum(met.cosine, 0.1)
    sigmas = np.full(len(residual), np.inf)
    for surface in range(TIP):
        rows = met.surface == surface
        if not rows.any():
            continue
        normal = np.abs(residual[rows] * cosine[rows])
        near = normal[normal < max(6.0 * scale_mm, 0.3)]
        spread = 1.4826 * float(np.median(near)) if len(near) > 5 else 0.03
        sigmas[rows] = max(spread, scale_mm, MIN_SIGMA_MM) / cosine[rows]
    ratio = np.where(np.isfinite(sigmas), np.abs(residual) / np.where(np.isfinite(sigmas), 4.7 * sigmas, 1.0), 2.0)
    weights = np.where(ratio < 1.0, (1.0 - np.minimum(ratio, 1.0) ** 2) ** 2, 0.0)
    return weights, np.where(np.isfinite(sigmas), sigmas, 1.0)


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Normal matrix in arrow form: own (n, OWN, OWN), border (n, OWN, SHARED), corner; right-hand sides."""

    own: Array
    border: Array
    corner: Array
    own_side: Array
    shared_side: Array

    @classmethod
    def of(cls, stud: NDArray[np.intp], count: int, met: Depths, weights: Array) -> _Blocks:
        rows = np.concatenate([met.own, met.shared, -np.nan_to_num(met.ahead_mm)[:, None]], axis=1)
        rows[weights == 0] = 0.0
        weighted = rows * weights[:, None]
        order = np.argsort(stud, kind="stable")
        starts = np.searchsorted(stud[order], np.arange(count + 1))
        size = OWN + SHARED + 1
        total = np.zeros((count, size, size))
        for i in range(count):
            mine = order[starts[i] : starts[i + 1]]
            total[i] = weighted[mine].T @ rows[mine]
        return cls(
            total[:, :OWN, :OWN],
            total[:, :OWN, OWN:-1],
            total[:, OWN:-1, OWN:-1].sum(axis=0),
            total[:, :OWN, -1],
            total[:, OWN:-1, -1].sum(axis=0),
        )

    def _with(self, priors: Priors) -> tuple[Array, Array]:
        """Inverse own blocks (n, OWN, OWN) and inverse Schur complement (SHARED, SHARED), priors included."""
        inverse = np.linalg.inv(self.own + np.diag(priors.own**-2.0 + 1e-12))
        schur = self.corner + np.diag(priors.shared**-2.0 + 1e-9)
        schur = schur - np.einsum("nka,nkl,nlb->ab", self.border, inverse, self.border)
        return np.asarray(inverse), np.asarray(np.linalg.inv(schur))

    def step(
        self, own: Array, shared: Array, start_own: Array, start_shared: Array, priors: Priors
    ) -> tuple[Array, Array]:
        inverse, corner = self._with(priors)
        known = start_own.copy()
        known[:, 2:4] = 0.0
        side = self.own_side + (known - own) * priors.own**-2.0
        border = self.shared_side + (start_shared - shared) * priors.shared**-2.0
        d_shared = corner @ (border - np.einsum("nka,nkl,nl->a", self.border, inverse, side))
        d_own = np.einsum("nkl,nl->nk", inverse, side - self.border @ d_shared)
        return d_own, d_shared

    def covariance(self, priors: Priors) -> tuple[Array, Array]:
        inverse, corner = self._with(priors)
        lever = np.einsum("nkl,nla->nka", inverse, self.border)
        return inverse + np.einsum("nka,ab,nlb->nkl", lever, corner, lever), corner
