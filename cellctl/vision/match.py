"""Face match and hole match: how far the shaft must move so that faces and bolts meet. Plain arrays, closed forms.

Angles are right-handed about the outward normal of the shaft's face. Feature i of one side meets feature i of the
other; `pairings` says which renumberings the pattern's own symmetry allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cellctl.vision.geometry import Array, rotate


@dataclass(frozen=True, slots=True)
class FaceMatch:
    """Two faces that look at each other. Lengths in mm.

    `gap_mm` is the distance along the travel direction at the given point, `least_gap_mm` the least over the rim,
    `tilt_deg` the angle between the faces, `tilt_axis` (3,) the direction about which the shaft would have to turn by
    it. `h_i_mm`, `h_j_mm` are the directed distances (eq. 21, 22), positive while the faces are apart.
    """

    tilt_deg: float
    tilt_axis: Array
    gap_mm: float
    least_gap_mm: float
    h_i_mm: Array
    h_j_mm: Array
    eps_pla: float


def match_faces(
    rotor: tuple[Array, Array],
    shaft: tuple[Array, Array],
    rotor_points_mm: Array,
    shaft_points_mm: Array,
    direction: Array,
    *,
    rim_radius_mm: float,
    h0_mm: float,
) -> FaceMatch:
    """Tilt and gap in closed form from the two faces (point, outward unit normal), all in one frame.

    `rotor_points_mm`, `shaft_points_mm` (n, 3) lie on the faces; `direction` (3,) is the shaft's travel towards the
    rotor. A common index of the paper (eq. 23) is reported, not minimised: any uniform gap scores 0 and no axis of
    the bench corrects tilt.
    """
    (p_b, n_b), (p_a, n_a) = rotor, shaft
    u = direction / np.linalg.norm(direction)
    h_i = (shaft_points_mm - p_b) @ n_b  # eq. 21: points of the shaft to the rotor's face
    h_j = (rotor_points_mm - p_a) @ n_a  # eq. 22: points of the rotor to the shaft's face
    cross = np.cross(n_a, -n_b)
    sine = float(np.linalg.norm(cross))
    tilt = float(np.arctan2(sine, -(n_a @ n_b)))
    axis = cross / sine if sine > 1e-15 else np.array([1.0, 0.0, 0.0])
    gap = float((p_b - p_a) @ n_b / (u @ n_b))
    least = gap - rim_radius_mm * np.tan(tilt)
    eps = max(float(np.max(np.abs(h)) - np.mean(np.abs(h))) for h in (h_i, h_j)) / h0_mm  # eq. 23
    return FaceMatch(float(np.degrees(tilt)), axis, gap, float(least), h_i, h_j, eps)


@dataclass(frozen=True, slots=True)
class HoleMatch:
    """Planar motion that brings the holes onto the studs: turn by `theta_rad` about the pivot, then shift (2,) mm.

    `residuals_mm` (n, 2) = moved hole minus stud. `covariance` (3, 3) of (x, y, theta) in mm2, mm rad, rad2 follows
    from the weights, at the pivot.
    """

    shift_mm: Array
    theta_rad: float
    residuals_mm: Array
    covariance: Array
    eps_cyc: float


def match_holes(holes_mm: Array, studs_mm: Array, variance_mm2: Array, pivot_mm: Array, *, d0_mm: float) -> HoleMatch:
    """Weighted least squares over x, y, theta in closed form (instead of eq. 28's argmin, which is degenerate).

    `holes_mm`, `studs_mm` (n, 2) in one plane, paired; `variance_mm2` (n,) per axis of each pair; n >= 2.
    Source: Umeyama, IEEE PAMI 13 (1991) 376, without scale, in the plane.
    """
    w = 1.0 / np.maximum(variance_mm2, 1e-12)
    total = w.sum()
    mean_h, mean_s = w @ holes_mm / total, w @ studs_mm / total
    a, b = holes_mm - mean_h, studs_mm - mean_s
    sine = float(w @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    theta = float(np.arctan2(sine, float(w @ np.sum(a * b, axis=1))))
    shift = mean_s - pivot_mm - rotate(mean_h - pivot_mm, theta)
    moved = pivot_mm + rotate(holes_mm - pivot_mm, theta) + shift  # eq. 25, right-handed about the shaft's normal
    arm = moved - pivot_mm - shift
    information = np.zeros((3, 3))
    information[0, 0] = information[1, 1] = total
    information[0, 2] = information[2, 0] = -w @ arm[:, 1]
    information[1, 2] = information[2, 1] = w @ arm[:, 0]
    information[2, 2] = w @ np.sum(arm**2, axis=1)
    distance = np.linalg.norm(moved - studs_mm, axis=1)  # eq. 26: parallel axes, so the distance in the plane
    eps = float(distance.max() - distance.mean()) / d0_mm  # eq. 27, reported only: a perfect pattern scores 0
    return HoleMatch(shift, theta, moved - studs_mm, np.asarray(np.linalg.inv(information), dtype=np.float64), eps)


def polish(offsets_mm: Array, jacobian: Array, clearance_mm: Array, *, softness_mm: float = 2e-7) -> Array:
    """Small motion (..., 3) that makes the least clearance as large as it can be, for each set of offsets by itself.

    Minimises max_i(|d_i + J_i v| - c_i) for offsets (..., m, 2), jacobian (m, 2, 3) and clearance (m,) through
    softness log sum_i exp(. / softness): convex, solved by damped Newton with a falling softness (Boyd, Vandenberghe
    2004, ch. 3 and 9). The result is within softness log m of the optimum; terms that differ by less than the
    softness count alike.
    """
    scale = np.sqrt(np.mean(jacobian**2, axis=(0, 1)))
    scale = np.where(scale > 0, scale, 1.0)
    jac = jacobian / scale
    offsets = offsets_mm.reshape(-1, *offsets_mm.shape[-2:])
    v = np.zeros((len(offsets), 3))
    mu = max(float(np.ptp(np.linalg.norm(offsets, axis=2) - clearance_mm, axis=1).max()), softness_mm)
    while True:
        v = _newton(offsets, jac, clearance_mm, v, mu)
        if mu <= softness_mm:
            return np.asarray(v.reshape(*offsets_mm.shape[:-2], 3) / scale)
        mu = max(mu * 0.3, softness_mm)


def _newton(d: Array, jac: Array, c: Array, v: Array, mu: float) -> Array:
    """Minimum of log sum exp(. / mu) for offsets (b, m, 2) from motions (b, 3) on."""
    soft = 1e-3 * mu  # keeps |d| differentiable where it vanishes

    def value(at: Array) -> tuple[Array, Array, Array, Array]:
        e = d + np.einsum("mak,bk->bma", jac, at)
        r = np.sqrt(np.sum(e**2, axis=2) + soft**2)
        g = (r - c) / mu
        top = g.max(axis=1)
        p = np.exp(g - top[:, None])
        total = p.sum(axis=1)
        return top + np.log(total), e / r[:, :, None], r, p / total[:, None]

    squares = np.einsum("mak,mal->mkl", jac, jac).reshape(-1, 9)
    f, unit, r, p = value(v)
    for _ in range(30):
        rows = np.einsum("bma,mak->bmk", unit, jac)
        gradient = np.einsum("bm,bmk->bk", p, rows) / mu
        bend = p / (r * mu)
        hessian = (bend @ squares).reshape(-1, 3, 3)
        hessian += np.swapaxes(rows * (p / mu**2 - bend)[:, :, None], 1, 2) @ rows
        hessian -= gradient[:, :, None] * gradient[:, None, :]
        ridge = 1e-12 * np.trace(hessian, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        step = -np.linalg.solve(hessian + ridge, gradient[:, :, None])[:, :, 0]
        slope = np.sum(gradient * step, axis=1)
        if not (slope < -1e-9).any():
            break
        length = np.where(slope < -1e-9, 1.0, 0.0)
        trial = value(v + length[:, None] * step)
        while (poor := (trial[0] > f + 0.25 * length * slope) & (length > 1e-6)).any():
            length = np.where(poor, 0.5 * length, length)
            trial = value(v + length[:, None] * step)
        v = v + length[:, None] * step
        f, unit, r, p = trial
    return v


def pairings(angles_deg: tuple[float, ...], *, free: bool, tolerance_deg: float = 0.1) -> tuple[tuple[int, ...], ...]:
    """Which stud each hole may meet: permutations that a turn of the pattern onto itself allows, identity first.

    With `free` false the numbering is proven on both sides and only the identity is left (the right pitch, always).
    """
    n = len(angles_deg)
    angles = np.asarray(angles_deg) % 360.0
    identity = tuple(range(n))
    found = [identity]
    for k in range(1, n) if free else ():
        turned = (angles + angles[k] - angles[0]) % 360.0
        difference = np.abs((turned[:, None] - angles[None, :] + 180.0) % 360.0 - 180.0)
        partner = difference.argmin(axis=1)
        if len(set(partner)) == n and difference.min(axis=1).max() <= tolerance_deg:
            found.append(tuple(int(i) for i in partner))
    return tuple(found)
