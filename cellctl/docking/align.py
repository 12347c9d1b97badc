"""`align`: pairing and least squares, minimax polish, then what that target is worth. Pure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cellctl.calibration import Calibration
from cellctl.docking.alignment import Alignment, AlignSpec, Station
from cellctl.docking.best_pose import aim, type_a
from cellctl.docking.joint import (
    Joint,
    arms_at,
    basis_of,
    holes_at,
    joint_of,
    joints_of,
    lags_at,
    offsets_at,
    own_errors,
    pivot_at,
    seat,
    shaft_face_at,
)
from cellctl.docking.prior import Believed, believed
from cellctl.docking.ripple import ripple_noise
from cellctl.docking.type_b import causes, rigid
from cellctl.kinematics import Array, AxesPosition
from cellctl.vision.match import FaceMatch, HoleMatch, match_faces, match_holes, pairings
from cellctl.vision.part import PartMeasurement, Refused
from cellctl.vision.uncertainty import Belief, TemperatureWindow, clearance, forecast, root, temperature_window


def align(
    rotor: PartMeasurement,
    shaft: PartMeasurement,
    calibration: Calibration,
    measured_at: AxesPosition,
    spec: AlignSpec,
) -> Alignment:
    """Axis target that brings every hole onto its stud, with clearances, probabilities and the temperature window.

    Both parts in the cell frame; `measured_at` is where the axes stood when the shaft was scanned. Raises Refused
    (features_missing, wrong_part, frames_disagree, out_of_range) where there is nothing to align.
    """
    _require(rotor, shaft, spec)
    seen, target = _least_squares(rotor, shaft, calibration, measured_at, spec)
    studs, holes = _believed(rotor, shaft, calibration, spec)
    joint = joint_of(studs.part, holes.part, seen.partner, calibration, measured_at)
    target = _serve_the_worst(joint, calibration, target, spec)
    meets = list(seen.partner)
    measured = _measured(joint, holes.noise_mm2 + studs.noise_mm2[meets], calibration, target)
    shares = (holes.share, studs.share[meets])
    stations = spec.stations()
    systematic = np.stack([causes(joint, calibration, measured_at, target, at, shares) for at in stations])
    everywhere = np.broadcast_to(measured, (len(stations), *measured.shape))
    belief = _belief(joint, calibration, target, spec, np.concatenate([everywhere, systematic], axis=3))
    aim_rng = np.random.default_rng((spec.seed, 1))
    covariance_a = type_a(belief, measured, aim_rng)
    covariance_b = rigid(systematic.mean(axis=0), belief.jacobian)
    free = rotor.clocking_free or shaft.clocking_free
    return _result(belief, joint, calibration, measured_at, target, spec, (covariance_a, covariance_b), free)


def _belief(joint: Joint, calibration: Calibration, at: AxesPosition, spec: AlignSpec, shared_mm: Array) -> Belief:
    """What is believed of the bolts with the axes at `at`, for causes (stations, n, 2, k) that they share."""
    stations = spec.stations()
    passes = [offsets_at(joint, calibration, at, station) for station in stations]
    return Belief(
        offsets_mm=np.stack([offsets for offsets, _ in passes]),
        entering=np.array([station.entering for station in stations]),
        lag_mm=lags_at(joint, calibration, at),
        growth_mm_per_k=_growth(joint, calibration, at, spec),
        jacobian=passes[-1][1],
        shared_mm=shared_mm,
        own_mm=np.stack([own_errors(joint, station) for station in stations]),
        clearance_mm=spec.clearances(),
    )


def _measured(joint: Joint, noise_mm2: Array, calibration: Calibration, at: AxesPosition) -> Array:
    """(n, 2, 3) what the measurement leaves open in the place of the whole pattern, as rigid causes.

    The mean of bolts whose offsets have the noise (n,) is known as well as that noise allows; what each bolt is
    believed to be wrong by for itself already makes up a part of it.
    """
    _, jacobian = offsets_at(joint, calibration, at, Station(0.0))
    left = max(float(np.mean(noise_mm2 - joint.variance_mm2)), 0.0)
    normal = np.einsum("iak,ial->kl", jacobian, jacobian)
    return np.asarray(jacobian @ root(left * np.linalg.inv(normal)))


def _believed(
    rotor: PartMeasurement, shaft: PartMeasurement, calibration: Calibration, spec: AlignSpec
) -> tuple[Believed, Believed]:
    """Rotor and shaft as they are believed to be, the drawing's position tolerance taken into account."""
    mirrored = tuple(-angle for angle in spec.angles_deg)
    sigma = spec.position_sigma_mm
    return (
        believed(rotor, mirrored, sigma, ripple_noise(rotor, calibration, "rotor")),
        believed(shaft, spec.angles_deg, sigma, ripple_noise(shaft, calibration, "shaft")),
    )


def _require(rotor: PartMeasurement, shaft: PartMeasurement, spec: AlignSpec) -> None:
    """A bolt that was not seen cannot be promised to insert."""
    for name, part in (("rotor", rotor), ("shaft", shaft)):
        if part.frame != "cell":
            raise Refused("frames_disagree", f"the {name} was not measured in the cell frame")
        if len(part.features) != len(spec.angles_deg):
            raise Refused("wrong_part", f"the {name} has {len(part.features)} features, not {len(spec.angles_deg)}")
        missing = [feature.index for feature in part.features if not feature.found]
        if missing:
            raise Refused("features_missing", f"the {name}'s features {missing} were not found")


def _least_squares(
    rotor: PartMeasurement,
    shaft: PartMeasurement,
    calibration: Calibration,
    measured_at: AxesPosition,
    spec: AlignSpec,
) -> tuple[Joint, AxesPosition]:
    """Pairing with the smallest turn and its least-squares target, repeated because the axes are not quite square."""
    free = rotor.clocking_free or shaft.clocking_free
    best: tuple[float, Joint, AxesPosition] | None = None
    partners = pairings(spec.angles_deg, free=free)
    for joint in joints_of(rotor, shaft, partners, calibration, measured_at):
        target = _step(joint, calibration, measured_at)
        turn = _in_range(target.theta_deg, measured_at.theta_deg, spec)
        if turn is None:
            continue
        size = abs(turn - measured_at.theta_deg)
        if best is None or size < best[0] - 1e-6:
            best = (size, joint, replace(target, theta_deg=turn))
    if best is None:
        raise Refused("out_of_range", "no allowed clocking lies within the travel of the shaft table")
    _, joint, target = best
    for _ in range(4):
        target = _step(joint, calibration, target)
    return joint, seat(joint, calibration, target, spec.rim_radius_mm)


def _step(joint: Joint, calibration: Calibration, at: AxesPosition) -> AxesPosition:
    """One closed-form correction of x, y, theta with the faces brought together."""
    at = seat(joint, calibration, at, 0.0)
    match = _match(joint, calibration, at, 1.0)
    return _moved(at, np.array([*match.shift_mm, match.theta_rad]), calibration)


def _match(joint: Joint, calibration: Calibration, at: AxesPosition, d0_mm: float) -> HoleMatch:
    across = basis_of(calibration)[:2]
    offsets, _ = offsets_at(joint, calibration, at, Station(0.0))
    holes = holes_at(joint, calibration, at)[0] @ across.T
    pivot = across @ pivot_at(calibration, at)
    return match_holes(holes, holes - offsets, joint.variance_mm2, pivot, d0_mm=d0_mm)


def _moved(at: AxesPosition, move: Array, calibration: Calibration) -> AxesPosition:
    """Axis position after a planar motion (x, y in the cell, turn in rad) about the table axis."""
    across = basis_of(calibration)[:2]
    columns = across @ np.array([calibration.stage.x_direction, calibration.stage.y_direction]).T
    x, y = np.linalg.solve(columns, move[:2])
    return replace(
        at, x_mm=at.x_mm + float(x), y_mm=at.y_mm + float(y), theta_deg=at.theta_deg + float(np.degrees(move[2]))
    )


def _in_range(theta_deg: float, present_deg: float, spec: AlignSpec) -> float | None:
    """The whole turn of `theta_deg` nearest the present angle that the table can reach."""
    turns = [theta_deg + 360.0 * k for k in range(-2, 3)]
    allowed = [turn for turn in turns if spec.theta_low_deg <= turn <= spec.theta_high_deg]
    return min(allowed, key=lambda turn: abs(turn - present_deg)) if allowed else None


def _growth(joint: Joint, calibration: Calibration, at: AxesPosition, spec: AlignSpec) -> Array:
    """How a hole moves against its stud per kelvin of difference (n, 2): the heated circle grows."""
    if spec.heated is None:
        return np.zeros((len(joint.holes), 2))
    sign = 1.0 if spec.heated == "shaft" else -1.0
    return sign * spec.expansion_per_k * arms_at(joint, calibration, at)


def _serve_the_worst(joint: Joint, calibration: Calibration, target: AxesPosition, spec: AlignSpec) -> AxesPosition:
    """Minimax polish over every bolt and station, cold and at docking temperature."""
    belief = _belief(joint, calibration, target, spec, np.zeros((len(spec.stations()), len(joint.holes), 2, 0)))
    move = aim(belief, spec.difference_k)
    return seat(joint, calibration, _moved(target, move, calibration), spec.rim_radius_mm)


def _faces(joint: Joint, calibration: Calibration, at: AxesPosition, spec: AlignSpec) -> FaceMatch:
    return match_faces(
        (joint.rotor_face[0], joint.rotor_face[1]),
        shaft_face_at(joint, calibration, at),
        joint.studs,
        holes_at(joint, calibration, at)[0],
        basis_of(calibration)[2],
        rim_radius_mm=spec.rim_radius_mm,
        h0_mm=spec.stand_off_mm,
    )


def _window(belief: Belief, spec: AlignSpec) -> TemperatureWindow:
    if spec.heated is None or spec.spigot_diameter_mm is None:
        return TemperatureWindow(0.0, float("inf"))
    return temperature_window(
        belief,
        interference_mm=spec.interference_mm,
        tolerance_mm=spec.interference_tolerance_mm,
        open_by_mm=spec.open_by_mm,
        expansion_per_k=spec.expansion_per_k,
        spigot_diameter_mm=spec.spigot_diameter_mm,
        coverage=spec.clearance_sigmas,
    )


def _result(
    belief: Belief,
    joint: Joint,
    calibration: Calibration,
    measured_at: AxesPosition,
    target: AxesPosition,
    spec: AlignSpec,
    covariances: tuple[Array, Array],
    clocking_free: bool,
) -> Alignment:
    cold_rng, hot_rng = np.random.default_rng(spec.seed).spawn(2)
    cold = forecast(belief, spec.contact, cold_rng, force_limit_n=spec.force_limit_n, samples=spec.samples)
    seated = belief.seated()
    hot = forecast(
        seated,
        spec.contact,
        hot_rng,
        difference_k=spec.difference_k,
        sigma_k=spec.difference_tolerance_k,
        force_limit_n=spec.force_limit_n,
        samples=spec.samples,
    )
    apart = replace(target, z_mm=target.z_mm - spec.stand_off_mm)
    faces = _faces(joint, calibration, apart, spec)
    match = _match(joint, calibration, target, float(belief.clearance_mm.min()))
    to_deg = np.diag([1.0, 1.0, 180.0 / np.pi])
    part_a, part_b = (to_deg @ covariance @ to_deg for covariance in covariances)
    both = part_a + part_b
    grown = seated.offsets_mm + spec.difference_k * belief.growth_mm_per_k
    return Alignment(
        x_mm=target.x_mm - measured_at.x_mm,
        y_mm=target.y_mm - measured_at.y_mm,
        theta_deg=target.theta_deg - measured_at.theta_deg,
        target=target,
        approach_z_mm=target.z_mm - spec.stud_length_mm - spec.stand_off_mm,
        tilt_deg=faces.tilt_deg,
        gap_mm=_faces(joint, calibration, measured_at, spec).gap_mm,
        sigma_theta_deg=float(np.sqrt(both[2, 2])),
        sigma_xy_mm=float(np.sqrt(np.linalg.eigvalsh(both[:2, :2])[-1])),
        covariance_a=part_a,
        covariance_b=part_b,
        clearance_mm=clearance(belief.offsets_mm, belief.clearance_mm),
        clearance_hot_mm=clearance(grown, belief.clearance_mm),
        p_insert=cold.p_free,
        p_insert_hot=hot.p_free,
        p_force_ok=cold.p_force_ok,
        predicted_peak_force_n=cold.peak_force_n,
        predicted_peak_bolt_n=cold.peak_bolt_n,
        window=_window(belief, spec),
        eps_pla=faces.eps_pla,
        eps_cyc=match.eps_cyc,
        offsets_mm=belief.offsets_mm[-1],
        h_i_mm=faces.h_i_mm,
        h_j_mm=faces.h_j_mm,
        partner=joint.partner,
        clocking_free=clocking_free,
    )
