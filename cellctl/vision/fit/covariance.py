"""Covariance (type A) of a least-squares fit, of the very numbers that a result carries."""

from __future__ import annotations

import numpy as np

from cellctl.vision.fit.result import Array


def type_a(jacobian: Array, residuals: Array, derivative: Array) -> Array:
    """Covariance of y = f(x) (k, k) for x fitted with `jacobian` (m, p): D s^2 (J^T J)^-1 D^T, D = dy/dx (k, p).

    s^2 = r^T r / (m - p) (Gauss-Markov), zero where no degree of freedom is left. The inverse comes from R of J = Q R
    with columns of length one, as J^T J would lose half of the digits.
    """
    degrees = jacobian.shape[0] - jacobian.shape[1]
    variance = float(residuals @ residuals) / degrees if degrees > 0 else 0.0
    scale = np.linalg.norm(jacobian, axis=0)
    triangle = np.asarray(np.linalg.qr(jacobian / scale, mode="r"))
    root = np.linalg.solve(triangle.T, (derivative / scale).T)
    return np.asarray(variance * (root.T @ root))
