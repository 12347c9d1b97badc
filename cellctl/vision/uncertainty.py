"""From offsets and covariances to a decision: clearance per bolt, probabilities, contact force, temperature window."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.contact import ContactModel, entry_forces, lateral_forces

Array = NDArray[np.float64]

CONTACTS = 256
"""Samples with contact whose forces are worked out."""


def clearance(offsets_mm: Array, clearance_mm: Array) -> Array:
    """Clearance left per bolt (n,): the least over the stations of c - |offset|. Offsets (stations, n, 2), c (n,)."""
    return np.asarray((clearance_mm - np.linalg.norm(offsets_mm, axis=-1)).min(axis=0))


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of the bolts once the shaft stands on its target.

    `offsets_mm` (stations, n, 2) hole minus stud where they pass each other, `entering` (stations,) where the stud's
    end passes the chamfer and `lag_mm` (n,) by how much later there than the first, `growth_mm_per_k` (n, 2) how a
    hole moves against its stud per kelvin, `jacobian` (n, 2, 3) of the offsets to a rigid motion (mm, mm, rad),
    `clearance_mm` (n,). Each error is one sigma of an independent cause: `shared_mm` (stations, n, 2, k) of k causes
    that move all bolts, `own_mm` (stations, n, m) per axis of m causes that each bolt has for itself, the same draw at
    all stations.
    """

    offsets_mm: Array
    entering: NDArray[np.bool_]
    lag_mm: Array
    growth_mm_per_k: Array
    jacobian: Array
    shared_mm: Array
    own_mm: Array
    clearance_mm: Array

    def seated(self) -> Belief:
        """The last station alone."""
        last = slice(-1, None)
        return replace(
            self,
            offsets_mm=self.offsets_mm[last],
            entering=self.entering[last],
            shared_mm=self.shared_mm[last],
            own_mm=self.own_mm[last],
        )


@dataclass(frozen=True, slots=True)
class InsertForecast:
    """`p_free` every bolt passes without contact; `p_force_ok` the total axial contact force stays within the limit.

    `peak_force_n` (total) and `peak_bolt_n` (worst bolt) are the 95 % quantiles; `sigma_p` the sampling error of
    `p_free`.
    """

    p_free: float
    p_force_ok: float
    peak_force_n: float
    peak_bolt_n: float
    sigma_p: float


def forecast(
    belief: Belief,
    model: ContactModel,
    generator: np.random.Generator,
    *,
    difference_k: float = 0.0,
    sigma_k: float = 0.0,
    force_limit_n: float = 10.0,
    samples: int = 8192,
) -> InsertForecast:
    """Simulate the belief `samples` times, at a temperature difference of the two parts (kelvin, heated holes grow).

    Antithetic pairs; `generator` decides every number.
    """
    drawn = _Draws.of(belief, generator, samples // 2, difference_k, sigma_k)
    room = np.square(belief.clearance_mm).astype(np.float32)
    touches = np.zeros(len(drawn.shared), dtype=bool)
    for station in range(len(belief.offsets_mm)):
        touches |= (np.square(drawn.at(belief, station, slice(None))).sum(axis=2) > room).any(axis=1)
    touched = np.flatnonzero(touches)
    # The distribution of the force needs no more than a few hundred contacts; they stand for the others.
    axial, peak = _forces(belief, drawn, touched[:: max(1, len(touched) // CONTACTS)], model)
    p = 1.0 - len(touched) / len(touches)
    within = float(np.mean(peak <= force_limit_n)) if len(peak) else 1.0
    return InsertForecast(
        p_free=p,
        p_force_ok=p + (1.0 - p) * within,
        peak_force_n=_quantile(peak, 0.95, p),
        peak_bolt_n=_quantile(axial.max(axis=1, initial=0.0), 0.95, p),
        sigma_p=float(np.sqrt(max(p * (1 - p), 1.0 / len(touches)) / len(touches))),
    )


@dataclass(frozen=True, slots=True)
class _Draws:
    """What bolts may be: numbers (samples, k + 1) of the causes that all share, standard normal but for the temperature
    difference that is the last, and standard normal numbers (samples, n, 2) for each cause of a bolt's own. Single
    precision is far finer than any probability here."""

    shared: NDArray[np.float32]
    own: tuple[NDArray[np.float32], ...]

    @classmethod
    def of(
        cls, belief: Belief, generator: np.random.Generator, half: int, difference_k: float, sigma_k: float
    ) -> _Draws:
        """`half` draws and their negatives; the temperature difference is the last of the shared causes."""
        count = len(belief.clearance_mm)

        def both(*shape: int) -> NDArray[np.float32]:
            draw = generator.standard_normal((half, *shape), dtype=np.float32)
            return np.concatenate([draw, -draw])

        shared = both(belief.shared_mm.shape[3] + 1)
        shared[:, -1] = difference_k + sigma_k * shared[:, -1]
        own = tuple(both(count, 2) for _ in range(belief.own_mm.shape[2]))
        return cls(shared, own)

    def at(self, belief: Belief, station: int, rows: NDArray[np.intp] | slice) -> NDArray[np.float32]:
        """Offsets (rows, n, 2) of some samples at a station."""
        causes = np.concatenate([belief.shared_mm[station], belief.growth_mm_per_k[:, :, None]], axis=2)
        common = self.shared[rows] @ causes.reshape(2 * len(causes), -1).T.astype(np.float32)
        offsets = common.reshape(-1, len(causes), 2) + belief.offsets_mm[station].astype(np.float32)
        for draw, sigma in zip(self.own, belief.own_mm[station].T.astype(np.float32), strict=True):
            offsets += draw[rows] * sigma[:, None]
        return np.asarray(offsets)


def _forces(belief: Belief, drawn: _Draws, chosen: NDArray[np.intp], model: ContactModel) -> tuple[Array, Array]:
    """Peak axial force (m, n) on each stud and (m,) of all together over the way in, for the chosen samples."""
    axial, peak = np.zeros((len(chosen), len(belief.clearance_mm))), np.zeros(len(chosen))
    for station, entering in enumerate(belief.entering if len(chosen) else ()):
        offsets = drawn.at(belief, station, chosen).astype(np.float64)
        if entering:
            now, total = entry_forces(offsets, belief.jacobian, belief.clearance_mm, belief.lag_mm, model)
        else:
            now = model.friction * lateral_forces(offsets, belief.jacobian, belief.clearance_mm, model)
            total = now.sum(axis=1)
        axial, peak = np.maximum(axial, now), np.maximum(peak, total)
    return axial, peak


def _quantile(forces: Array, q: float, free: float) -> float:
    """Quantile of a force that is 0 with the probability `free` and else one of `forces` (m,), all alike likely."""
    if q <= free or not len(forces):
        return 0.0
    return float(np.quantile(forces, (q - free) / (1.0 - free)))


@dataclass(frozen=True, slots=True)
class TemperatureWindow:
    """Temperature difference (kelvin) between the parts at which the spigot goes home; `reason` "" where it exists."""

    low_k: float
    high_k: float
    reason: str = ""

    @property
    def exists(self) -> bool:
        """Whether any temperature difference serves both sides."""
        return not self.reason


def temperature_window(
    belief: Belief,
    *,
    interference_mm: float,
    tolerance_mm: float,
    open_by_mm: float,
    expansion_per_k: float,
    spigot_diameter_mm: float,
    coverage: float = 3.0,
) -> TemperatureWindow:
    """T_min opens the fit by `open_by_mm` (diametral); T_max leaves the worst stud `coverage` sigma of clearance.

    Per bolt |d + g T| <= c - coverage sigma is a quadratic in T; the last station (seated) counts. Without growth
    T_max is infinite.
    """
    low = max(0.0, (interference_mm + tolerance_mm + open_by_mm) / (expansion_per_k * spigot_diameter_mm))
    d, g = belief.offsets_mm[-1], belief.growth_mm_per_k
    sigma = radial_sigma(belief)[-1]
    room = belief.clearance_mm - coverage * sigma
    now = np.linalg.norm(d, axis=1)
    if np.any(now > room):
        worst = int(np.argmax(now - room))
        return TemperatureWindow(low, 0.0, f"bolt {worst} has no {coverage:g} sigma of clearance even cold")
    a, b, c = np.sum(g * g, axis=1), np.sum(g * d, axis=1), now**2 - room**2
    with np.errstate(divide="ignore", invalid="ignore"):
        high = np.where(a > 0, (-b + np.sqrt(np.maximum(b * b - a * c, 0.0))) / np.where(a > 0, a, 1.0), np.inf)
    worst = int(np.argmin(high))
    reason = ""
    if high[worst] < low:
        reason = (
            f"the fit opens at {low:.1f} K, but bolt {worst} keeps {coverage:g} sigma of clearance "
            f"only up to {high[worst]:.1f} K"
        )
    return TemperatureWindow(low, float(high[worst]), reason)


def radial_sigma(belief: Belief) -> Array:
    """One sigma (stations, n) in mm of each bolt's offset along its own direction, all causes together."""
    norm = np.linalg.norm(belief.offsets_mm, axis=2, keepdims=True)
    unit = np.where(norm > 1e-9, belief.offsets_mm / np.maximum(norm, 1e-9), np.sqrt(0.5))
    shared = np.einsum("sia,siak->sik", unit, belief.shared_mm)
    return np.asarray(np.sqrt(np.sum(shared**2, axis=2) + np.sum(belief.own_mm**2, axis=2)))


def root(covariance: Array) -> Array:
    """Square root (k, k) of a covariance that may be singular, with a fixed choice of signs."""
    values, vectors = np.linalg.eigh(covariance)
    vectors = vectors * np.where(vectors[np.abs(vectors).argmax(axis=0), range(len(values))] < 0, -1.0, 1.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
