"""Covariance (type A) of a least-squares fit from its Jacobian and residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def type_a(jacobian: Array, residuals: Array) -> Array:
    """s^2 (J^T J)^-1 (p, p), s^2 = r^T r / (m - p) (Gauss-Markov). Zero where no degree of freedom is left."""
    degrees = jacobian.shape[0] - jacobian.shape[1]
    variance = float(residuals @ residuals) / degrees if degrees > 0 else 0.0
    return np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))


def carried(covariance: Array, derivative: Array) -> Array:
    """Covariance of y = f(x) from that of x and dy/dx: D C D^T."""
    return np.asarray(derivative @ covariance @ derivative.T)
