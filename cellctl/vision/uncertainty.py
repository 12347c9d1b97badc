"""From offsets and covariances to a decision: clearance per bolt, probabilities, contact force, temperature window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ContactModel:
    """What the shaft feels when a stud meets the chamfer of its hole.

    `lateral_n_per_mm` holds the shaft in x, y and tangentially at the bolt circle; `stud_n_per_mm` is a stud's
    bending; the chamfer makes `chamfer_deg` with the hole's axis.
    """

    lateral_n_per_mm: float = 1000.0
    stud_n_per_mm: float = 15000.0
    friction: float = 0.15
    chamfer_deg: float = 45.0

    @property
    def axial_per_lateral(self) -> float:
        """Axial over lateral force while a stud wedges on the chamfer: (tan phi + mu) / (1 - mu tan phi)."""
        slope = float(np.tan(np.radians(self.chamfer_deg)))
        return (slope + self.friction) / (1.0 - self.friction * slope)


def clearance(offsets_mm: Array, clearance_mm: Array) -> Array:
    """Clearance left per bolt (n,): the least over the stations of c - |offset|. Offsets (stations, n, 2), c (n,)."""
    return np.asarray((clearance_mm - np.linalg.norm(offsets_mm, axis=-1)).min(axis=0))


@dataclass(frozen=True, slots=True)
class Belief:
    """What is believed of the bolts once the shaft stands on its target.

    `offsets_mm` (stations, n, 2) hole minus stud where they pass each other, `growth_mm_per_k` (n, 2) how a hole
    moves against its stud per kelvin, `jacobian` (n, 2, 3) of the offsets to a rigid motion (mm, mm, rad),
    `rigid_covariance` (3, 3) of that motion, `scatter_mm2` (stations, n) per axis and bolt, independent between
    bolts; a bolt's error is taken as common to its stations. `clearance_mm` (n,).
    """

    offsets_mm: Array
    growth_mm_per_k: Array
    jacobian: Array
    rigid_covariance: Array
    scatter_mm2: Array
    clearance_mm: Array


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
    half = samples // 2
    count = len(belief.clearance_mm)

    def both(*shape: int) -> Array:
        """Standard normal numbers and their negatives; single precision is far finer than any probability here."""
        draw = generator.standard_normal((half, *shape), dtype=np.float32)
        return np.concatenate([draw, -draw])

    rigid = both(3) @ _root(belief.rigid_covariance).T.astype(np.float32)
    shared = np.concatenate([rigid, difference_k + sigma_k * both(1)], axis=1).astype(np.float32)
    design = np.concatenate([belief.jacobian, belief.growth_mm_per_k[:, :, None]], axis=2)
    common = (shared @ design.reshape(-1, 4).T.astype(np.float32)).reshape(-1, count, 2)
    own = both(count, 2)
    free = np.ones(len(own), dtype=bool)
    total, worst = np.zeros(len(own)), np.zeros(len(own))
    room = np.square(belief.clearance_mm).astype(np.float32)
    for offsets, variance in zip(belief.offsets_mm, belief.scatter_mm2, strict=True):
        there = own * np.sqrt(variance)[:, None].astype(np.float32)
        there += common
        there += offsets.astype(np.float32)
        over = there[..., 0] ** 2 + there[..., 1] ** 2 > room
        touched = np.flatnonzero(over.any(axis=1))
        free[touched] = False
        if len(touched):
            # The distribution of the force needs no more than a few hundred contacts; they stand for the others.
            chosen = touched[:: max(1, len(touched) // 512)]
            axial = contact_forces(there[chosen].astype(np.float64), belief.jacobian, belief.clearance_mm, model)
            place = np.minimum(np.searchsorted(chosen, touched), len(chosen) - 1)
            total[touched] = np.maximum(total[touched], axial.sum(axis=1)[place])
            worst[touched] = np.maximum(worst[touched], axial.max(axis=1)[place])
    p = float(free.mean())
    return InsertForecast(
        p_free=p,
        p_force_ok=float(np.mean(total <= force_limit_n)),
        peak_force_n=float(np.quantile(total, 0.95)),
        peak_bolt_n=float(np.quantile(worst, 0.95)),
        sigma_p=float(np.sqrt(max(p * (1 - p), 1.0 / len(own)) / len(own))),
    )


def contact_forces(offsets_mm: Array, jacobian: Array, clearance_mm: Array, model: ContactModel) -> Array:
    """Axial force (samples, n) in newton on each stud once the shaft has floated to its equilibrium.

    The float v (x, y, turn) minimises half the energy of the shaft's lateral spring plus that of every overlapping
    stud, a convex problem; semi-smooth Newton with step control, all samples at once.
    """
    arm2 = float(np.mean(np.sum(jacobian[:, :, 2] ** 2, axis=1)))
    spring = model.lateral_n_per_mm * np.diag([1.0, 1.0, arm2])
    ks = model.stud_n_per_mm
    v = np.zeros((len(offsets_mm), 3))

    def state(at: Array) -> tuple[Array, Array, Array, Array]:
        e = offsets_mm + np.einsum("iak,sk->sia", jacobian, at)
        r = np.maximum(np.linalg.norm(e, axis=2), 1e-12)
        overlap = np.maximum(r - clearance_mm, 0.0)
        energy = 0.5 * np.einsum("sk,kl,sl->s", at, spring, at) + 0.5 * ks * np.sum(overlap**2, axis=1)
        return np.asarray(energy), e / r[:, :, None], r, overlap

    energy, unit, r, overlap = state(v)
    for _ in range(25):
        rows = np.einsum("sia,iak->sik", unit, jacobian)
        gradient = v @ spring + ks * np.einsum("si,sik->sk", overlap, rows)
        active = (overlap > 0).astype(np.float64)
        bend = active * overlap / r
        hessian = spring + ks * (
            np.einsum("si,sik,sil->skl", active - bend, rows, rows)
            + np.einsum("si,iak,ial->skl", bend, jacobian, jacobian)
        )
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
    return np.asarray(ks * overlap * model.axial_per_lateral)


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
    """One sigma (stations, n) in mm of each bolt's offset along its own direction, rigid part and scatter together."""
    norm = np.linalg.norm(belief.offsets_mm, axis=2, keepdims=True)
    unit = np.where(norm > 1e-9, belief.offsets_mm / np.maximum(norm, 1e-9), np.sqrt(0.5))
    rows = np.einsum("sia,iak->sik", unit, belief.jacobian)
    rigid = np.einsum("sik,kl,sil->si", rows, belief.rigid_covariance, rows)
    return np.asarray(np.sqrt(rigid + belief.scatter_mm2))


def _root(covariance: Array) -> Array:
    """Square root of a covariance that may be singular, with a fixed choice of signs."""
    values, vectors = np.linalg.eigh(covariance)
    vectors = vectors * np.where(vectors[np.abs(vectors).argmax(axis=0), range(len(values))] < 0, -1.0, 1.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
