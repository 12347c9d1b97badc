"""Normal equations of alike studs in arrow form: one small block a stud, a border for what they share. Pure.

Solved by the Schur complement, so that the cost is linear in points and studs. Sums are formed in blocks so small
that a matrix library gives each to one thread: the bits do not depend on the number of threads.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.thread_surface import OWN, SIZE, Array

BLOCK = 1024
LEAN_GRID = np.geomspace(1.0 / 64.0, 4096.0, 97)
"""Variances that are weighed, over the one that drawings allow."""
LEAN_DEGREES = 4.0
"""What is known beforehand of how studs lean weighs as much as two studs."""


@dataclass(frozen=True, slots=True)
class Priors:
    """One sigma of what is known beforehand; infinite where nothing is. `own` (OWN,) about zero slopes and about the
    start for the rest; `shared` (SHARED,) about the start."""

    own: Array
    shared: Array

    def leaning(self, lean_rad: float) -> Priors:
        """With another sigma of how studs lean."""
        own = self.own.copy()
        own[2:4] = lean_rad
        return replace(self, own=own)


@dataclass(frozen=True, slots=True)
class Normal:
    """Weighted sums of products (n, SIZE, SIZE) of each stud's rows: derivatives by own, by shared, right-hand side."""

    total: Array

    @classmethod
    def empty(cls, count: int) -> Normal:
        """For `count` studs."""
        return cls(np.zeros((count, SIZE, SIZE)))

    def add(self, rows: Array, weights: Array, stud: NDArray[np.intp]) -> None:
        """Add rows (SIZE, N) of points sorted by `stud` (N,), with weights (N,)."""
        weighted = rows * weights
        for begin, end in _spans(stud):
            for first in range(begin, end, BLOCK):
                block = np.s_[:, first : min(first + BLOCK, end)]
                self.total[stud[begin]] += weighted[block] @ rows[block].T

    def over(self, factor: float) -> Normal:
        """For noise of `factor` times the variance: the data tell less, the priors as much as before."""
        return Normal(self.total / factor)

    @property
    def own(self) -> Array:
        """(n, OWN, OWN)."""
        return self.total[:, :OWN, :OWN]

    @property
    def border(self) -> Array:
        """(n, OWN, SHARED)."""
        return self.total[:, :OWN, OWN:-1]

    def inverses(self, priors: Priors) -> tuple[Array, Array]:
        """Inverse own blocks (n, OWN, OWN) and inverse Schur complement (SHARED, SHARED), priors included."""
        inverse = np.linalg.inv(self.own + np.diag(priors.own**-2.0 + 1e-12))
        corner = self.total[:, OWN:-1, OWN:-1].sum(axis=0) + np.diag(priors.shared**-2.0 + 1e-9)
        schur = corner - np.einsum("nka,nkl,nlb->ab", self.border, inverse, self.border)
        return np.asarray(inverse), np.asarray(np.linalg.inv(schur))

    def step(self, now: tuple[Array, Array], known: tuple[Array, Array], priors: Priors) -> tuple[Array, Array]:
        """Gauss-Newton step of own and shared parameters; slopes are pulled to zero, the rest to what was known."""
        inverse, corner = self.inverses(priors)
        mean = known[0].copy()
        mean[:, 2:4] = 0.0
        side = self.total[:, :OWN, -1] + (mean - now[0]) * priors.own**-2.0
        border = self.total[:, OWN:-1, -1].sum(axis=0) + (known[1] - now[1]) * priors.shared**-2.0
        d_shared = corner @ (border - np.einsum("nka,nkl,nl->a", self.border, inverse, side))
        d_own = np.einsum("nkl,nl->nk", inverse, side - self.border @ d_shared)
        return d_own, d_shared

    def covariance(self, priors: Priors) -> tuple[Array, Array]:
        """Of own (n, OWN, OWN) and shared (SHARED, SHARED) parameters."""
        inverse, corner = self.inverses(priors)
        lever = np.einsum("nkl,nla->nka", inverse, self.border)
        return inverse + np.einsum("nka,ab,nlb->nkl", lever, corner, lever), corner

    def excess(
        self, rows: Array, weights: Array, stud: NDArray[np.intp], tiles: NDArray[np.intp], priors: Priors
    ) -> float:
        """How many times the variance of the studs' places exceeds the one of independent rows; at least 1.

        Tiles of pixels stand for independent groups, pooled over all studs (Liang, Zeger, Biometrika 73 (1986) 13),
        corrected for the parameters that the fit took from each stud's tiles.
        """
        inverse, _ = self.inverses(priors)
        influence = np.concatenate([inverse[stud[a], :2] @ rows[:OWN, a:b] for a, b in _spans(stud)], axis=1)
        influence *= rows[-1] * weights
        most = int(tiles.max()) + 1
        labels, group = np.unique(stud * most + tiles, return_inverse=True)
        groups = np.bincount(labels // most, minlength=len(inverse))
        sums = np.stack([np.bincount(group, influence[axis]) for axis in (0, 1)])
        beside = groups[labels // most]
        correction, enough = beside / np.maximum(beside - 3.0, 1.0), beside > 4
        found = float(np.sum((sums**2 * correction)[:, enough]))
        data = inverse @ self.own @ inverse
        expected = float(np.sum(np.einsum("nkk->n", data[:, :2, :2])[groups > 4]))
        return max(found / expected, 1.0) if expected > 0 else 1.0


def _spans(stud: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Begin and end of the points of each stud that has any; `stud` (N,) is sorted."""
    cuts = [0, *(np.flatnonzero(np.diff(stud)) + 1).tolist(), len(stud)]
    return list(itertools.pairwise(cuts))


def lean_sigma(normal: Normal, own: Array, known: Array, priors: Priors) -> float:
    """One sigma in rad of how studs lean, as wide as all studs together show it.

    Root of the variance that is expected of what the studs show, given what drawings allow (a scaled inverse chi square
    of few degrees of freedom, so that few studs do not claim to know it well; Gelman, Bayesian Data Analysis, 2.6). The
    likeliest variance would be too small: it is skewed.
    """
    slopes, others = [2, 3], [0, 1, 4, 5]
    precision = priors.own**-2.0
    whole = normal.own + np.diag(np.where(np.isin(np.arange(OWN), slopes), 0.0, precision + 1e-12))
    # what the data say once the priors' pull on place, phase and lead-in is part of them; slopes about zero
    side = normal.total[:, :OWN, -1] + np.einsum("nkl,nl->nk", normal.own[:, :, slopes], own[:, slopes])
    side[:, others] += (known - own)[:, others] * precision[others]
    across = whole[:, slopes][:, :, others]
    solved = np.linalg.solve(
        whole[:, others][:, :, others], np.concatenate([across.transpose(0, 2, 1), side[:, others, None]], axis=2)
    )
    information = whole[:, slopes][:, :, slopes] - across @ solved[:, :, :2]
    pull = side[:, slopes] - (across @ solved[:, :, 2:])[:, :, 0]
    # in the axes of each stud's information the rounds are sums of numbers
    known_by, axes = np.linalg.eigh(information)
    pulled = np.einsum("nkl,nk->nl", axes, pull)
    # each axis of a stud's information shows one slope, whose variance about zero is that of the lean and its own
    variance = float(priors.own[2]) ** 2 * LEAN_GRID
    gain = variance[:, None, None] * known_by
    likelihood = 0.5 * np.sum(variance[:, None, None] * pulled**2 / (1.0 + gain) - np.log1p(gain), axis=(1, 2))
    prior = -0.5 * LEAN_DEGREES * (np.log(LEAN_GRID) + 1.0 / LEAN_GRID)
    weight = np.exp(likelihood + prior - np.max(likelihood + prior))
    return float(np.sqrt(weight @ variance / weight.sum()))
