"""Nonlinear least squares for a handful of parameters, taken to the rounding of the data.

Levenberg-Marquardt, then Newton steps with the exact Hessian (differences of the analytic gradient): on short arcs
Gauss-Newton creeps along the valley, Newton lands at the bottom.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Model = Callable[[Array], tuple[Array, Array]]


@dataclass(frozen=True, slots=True)
class Minimum:
    """Where the sum of squares is least: parameters (p,), residuals (m,), Jacobian (m, p), and why it stopped."""

    parameters: Array
    residuals: Array
    jacobian: Array
    iterations: int
    stopped: str

    @property
    def cost(self) -> float:
        """Sum of squares."""
        return float(self.residuals @ self.residuals)


def least_squares(model: Model, start: Array, *, limit: int = 300) -> Minimum:
    """Minimum of |r|^2 near `start`, where `model(parameters)` gives residuals (m,) and Jacobian (m, p).

    Parameters should be of order one. A step that gives no finite number is not taken.
    """
    x = np.array(start, dtype=np.float64)
    residuals, jacobian = model(x)
    cost, damping, calm = float(residuals @ residuals), 1e-3, 0
    stopped, done = "limit", limit
    for iteration in range(limit):
        hessian, gradient = jacobian.T @ jacobian, jacobian.T @ residuals
        scale = np.maximum(np.diag(hessian), 1e-14 * max(float(np.diag(hessian).max()), 1e-300))
        step = np.linalg.lstsq(hessian + damping * np.diag(scale), -gradient, rcond=None)[0]
        trial = x + step
        new_residuals, new_jacobian = model(trial)
        new_cost = float(new_residuals @ new_residuals)
        if np.isfinite(new_cost) and new_cost <= cost:
            calm = calm + 1 if cost - new_cost <= 1e-14 * cost else 0
            x, residuals, jacobian, cost = trial, new_residuals, new_jacobian, new_cost
            damping = max(0.1 * damping, 1e-14)
        else:
            damping *= 8.0
        if damping > 1e12 or calm >= 3 or float(np.abs(step).max()) < 1e-15:
            stopped, done = "converged", iteration + 1
            break
    return _newton(model, Minimum(x, residuals, jacobian, done, stopped))


def _newton(model: Model, found: Minimum) -> Minimum:
    """Newton steps on the gradient as long as they make it smaller."""
    best = found
    norm = float(np.abs(best.jacobian.T @ best.residuals).max())
    for _ in range(8):
        x, size = best.parameters, len(best.parameters)
        hessian = np.empty((size, size))
        for i in range(size):
            shift = np.zeros(size)
            shift[i] = 1e-5
            ahead, ahead_jacobian = model(x + shift)
            behind, behind_jacobian = model(x - shift)
            hessian[i] = (ahead_jacobian.T @ ahead - behind_jacobian.T @ behind) / 2e-5
        hessian = 0.5 * (hessian + hessian.T)
        if not np.isfinite(hessian).all() or np.linalg.eigvalsh(hessian)[0] <= 0.0:
            break
        trial = x - np.linalg.solve(hessian, best.jacobian.T @ best.residuals)
        residuals, jacobian = model(trial)
        new_norm = float(np.abs(jacobian.T @ residuals).max())
        if not np.isfinite(new_norm) or new_norm >= norm:
            break
        best, norm = Minimum(trial, residuals, jacobian, best.iterations + 1, "converged"), new_norm
    return best
