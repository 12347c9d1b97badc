"""How well the centres of spheres are known: what repetition shows, and what ripple does to them. Pure."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cellctl.docking.ripple import correlation, slope_per_mm
from cellctl.vision.geometry import Array
from cellctl.vision.spheres import SphereFit

CAP_SHARE = 0.62
"""A slope of the depth error moves a sphere sideways by this share of slope times radius: the mean cosine of incidence
over a cap seen up to 70 degrees, weighted with the square of the distance from its middle."""


def repeatability(looks: Sequence[Sequence[SphereFit]], seen: Array) -> tuple[Array, float]:
    """Covariance (3n, 3n) of the mean centres, from their scatter over the looks; scatter of one centre per axis."""
    count, spheres = seen.shape[:2]
    cofactors = np.mean([[fit.cofactor for fit in look] for look in looks], axis=0)
    apart = seen - seen.mean(axis=0)
    squares = np.einsum("kni,nij,knj->", apart, np.linalg.inv(cofactors), apart)
    variance = float(squares) / (3 * spheres * (count - 1))
    covariance = np.zeros((3 * spheres, 3 * spheres))
    for i, cofactor in enumerate(cofactors):
        covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = variance * cofactor / count
    return covariance, float(np.sqrt(np.sum(apart**2) / (3 * spheres * (count - 1))))


def ripple(centres: Array, sigma_mm: float, radius_mm: float) -> Array:
    """(3n, 3n): depth along the rays, which near spheres share, and its slope, which moves a sphere sideways."""
    rays = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    shared = np.einsum("ij,ia,jb->iajb", correlation(distance), rays, rays)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    aside = (CAP_SHARE * radius_mm * slope_per_mm()) ** 2
    for i, plane in enumerate(across):
        shared[i, :, i, :] += aside * plane
    return np.asarray(sigma_mm**2 * shared.reshape(centres.size, centres.size))
