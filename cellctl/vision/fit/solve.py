"""Nonlinear least squares for a handful of parameters: many starts coarsely, the best of them to the rounding.

On short arcs the sum of squares is a long bent valley: Levenberg-Marquardt finds it, and Newton's method with the
exact Hessian lands at its bottom, where Gauss-Newton would creep.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from cellctl.vision.fit.result import Array

Model = Callable[[Array, Array], tuple[Array, Array]]
LEAST_EFFECT = 1e-7
"""Of one parameter beside the others, compared with the greatest; parameters are of order one."""
EPS = float(np.finfo(float).eps)
TINY = 1e-300


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

    @property
    def rounding(self) -> float:
        """What of the cost is rounding."""
        error = 4.0 * EPS * (1.0 + float(np.abs(self.parameters).max())) * np.sqrt(len(self.residuals))
        return float(error * (np.sqrt(self.cost) + error))


def descend(model: Model, points: Array, starts: Array, rounds: int) -> tuple[Array, Array]:
    """Levenberg-Marquardt from many starts (b, p) on points (b, n, 3): parameters (b, p), sums of squares (b,).

    Parameters should be of order one. A step that gives no finite number is not taken.
    """
    x, damping = starts.copy(), np.full(len(starts), 1e-2)
    residuals, jacobian = model(points, x)
    cost = (residuals**2).sum(axis=1)
    for _ in range(rounds):
        turned = np.swapaxes(jacobian, 1, 2)
        normal, gradient = turned @ jacobian, turned @ residuals[..., None]
        size = np.diagonal(normal, axis1=1, axis2=2)
        size = np.maximum(size, 1e-9 * size.max(axis=1, keepdims=True) + 1e-30)
        normal += (damping[:, None] * size)[:, None] * np.eye(x.shape[1])
        trial = x - np.linalg.solve(normal, gradient)[..., 0]
        new_residuals, new_jacobian = model(points, trial)
        new_cost = (new_residuals**2).sum(axis=1)
        better = new_cost <= cost  # never where it is not a number
        x[better], cost[better] = trial[better], new_cost[better]
        residuals[better], jacobian[better] = new_residuals[better], new_jacobian[better]
        damping = np.clip(np.where(better, 0.1 * damping, 8.0 * damping), 1e-9, 1e9)
    return x, cost


def settle(model: Model, points: Array, start: Array, limit: int) -> Minimum:
    """Minimum of |r|^2 for points (n, 3) by damped Newton steps from `start`, to the rounding of the numbers.

    Where rounding hides whether the sum of squares still falls, full steps are taken as long as they get shorter.
    """
    x, damping, last, patience = start, 0.0, np.inf, 3
    residuals, jacobian = model(points, x)
    for iteration in range(limit):
        scale, values, vectors = _curvature(model, points, x, residuals, jacobian)
        inside = vectors.T @ ((jacobian.T @ residuals) / scale)
        sharp = np.maximum(np.abs(values), EPS * np.abs(values).max() + TINY)
        found = Minimum(x, residuals, jacobian, iteration, "converged")
        hidden = values[0] > 0.0 and float((inside**2 / sharp).sum()) <= found.rounding
        if hidden:
            size, damping = float(np.linalg.norm(inside / sharp)), 0.0
            patience -= 1 if size >= 0.5 * last else 0
            if size == 0.0 or patience == 0 or (size >= 0.5 * last and size < 1e-9):
                return found
            last = size
        while True:
            trial = x - vectors @ (inside / (sharp + damping)) / scale
            trial_residuals, trial_jacobian = model(points, trial)
            if hidden or float(trial_residuals @ trial_residuals) <= found.cost:
                break
            damping = max(8.0 * damping, 1e-3 * float(sharp.min()))
            if damping > 1e12 * sharp.max():
                return replace(found, stopped="no way down")
        x, residuals, jacobian = trial, trial_residuals, trial_jacobian
        damping = 0.1 * damping if damping > 1e-3 * float(sharp.min()) else 0.0
    return replace(found, stopped="limit")


def determined(jacobian: Array) -> bool:
    """Whether the residuals tell every parameter from the others, well above the rounding of the numbers."""
    values = np.linalg.svd(jacobian, compute_uv=False)
    return bool(values[-1] > LEAST_EFFECT * values[0])


def _curvature(model: Model, points: Array, x: Array, residuals: Array, jacobian: Array) -> tuple[Array, Array, Array]:
    """Unit of each parameter (p,), eigenvalues (p,) ascending and vectors of the Hessian in those units.

    J^T J as it is and differences of J^T r for the rest, so that their error is as small as the residuals.
    """
    hessian = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(hessian))
    scale = np.maximum(scale, LEAST_EFFECT * scale.max() + TINY)
    step = 1e-5
    for i, shift in enumerate(step * np.eye(len(x))):
        _, ahead = model(points, x + shift)
        _, behind = model(points, x - shift)
        hessian[i] += (ahead - behind).T @ residuals / (2.0 * step)
    scaled = 0.5 * (hessian + hessian.T) / np.outer(scale, scale)
    if not np.isfinite(scaled).all():
        return scale, np.zeros(len(x)), np.eye(len(x))
    values, vectors = np.linalg.eigh(scaled)
    return scale, values, vectors
