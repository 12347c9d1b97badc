"""Contact of studs and holes against closed forms: one stud alone, the wedging limit, energy."""

from __future__ import annotations

import numpy as np
import pytest

from hal.fake.contact.contact import Contacts, EntryProfile, allowance, axial_ratio, solve

STIFFNESS = np.array([1000.0, 1000.0, 1000.0])
RADIUS_MM = 120.0


def one(offset_mm: tuple[float, float], *, free_mm: float = 0.15, bend: float = 10_000.0) -> Contacts:
    """One stud at angle 0 of the circle (arm along x)."""
    return Contacts(
        offset_mm=np.array([[offset_mm]]),
        arm_mm=np.array([[[RADIUS_MM, 0.0]]]),
        free_mm=np.array([[free_mm]]),
        tan_phi=np.array([[1.0]]),
        stiffness_n_per_mm=np.array([[bend]]),
        stud=np.array([0]),
    )


def profile(*, lead_in_deg: float = 45.0, chamfer_deg: float = 45.0) -> EntryProfile:
    return EntryProfile(
        hole_mm=np.array([4.15]),
        chamfer_mm=np.array([4.95]),
        stud_mm=np.array([4.0]),
        tip_mm=np.array([3.4]),
        tan_chamfer=float(np.tan(np.radians(chamfer_deg))),
        tan_lead_in=float(np.tan(np.radians(lead_in_deg))),
    )


def test_inside_the_clearance_nothing_touches() -> None:
    result = solve(one((0.149, 0.0)), STIFFNESS, RADIUS_MM)
    assert not result.lateral_n.any()
    assert not result.float_mm.any()


def test_one_stud_alone_radially_is_chuck_and_stud_in_series() -> None:
    result = solve(one((0.25, 0.0)), STIFFNESS, RADIUS_MM)
    expected = 0.1 / (1.0 / 1000.0 + 1.0 / 10_000.0)
    assert result.lateral_n[0, 0] == pytest.approx(expected, rel=1e-6)
    assert result.float_mm[0] == pytest.approx([expected / 1000.0, 0.0, 0.0], abs=1e-9)


def test_one_stud_alone_tangentially_yields_by_shift_and_by_turn() -> None:
    # A small tangential overlap, so that the direction of the contact stays.
    result = solve(one((0.0, 0.151)), STIFFNESS, RADIUS_MM)
    expected = 0.001 / (2.0 / 1000.0 + 1.0 / 10_000.0)
    assert result.lateral_n[0, 0] == pytest.approx(expected, rel=1e-6)
    assert result.float_mm[0, 1] == pytest.approx(result.float_mm[0, 2], rel=1e-9)


def test_heights_are_solved_independently_of_each_other() -> None:
    rng = np.random.default_rng(3)
    contacts = ring(rng, heights=7)
    whole = solve(contacts, STIFFNESS, RADIUS_MM)
    for m in range(7):
        single = Contacts(
            contacts.offset_mm[m : m + 1],
            contacts.arm_mm[m : m + 1],
            contacts.free_mm[m : m + 1],
            contacts.tan_phi[m : m + 1],
            contacts.stiffness_n_per_mm[m : m + 1],
            contacts.stud,
        )
        assert solve(single, STIFFNESS, RADIUS_MM).lateral_n[0] == pytest.approx(whole.lateral_n[m], abs=1e-5)


def ring(rng: np.random.Generator, heights: int, count: int = 36) -> Contacts:
    """Studs all round with random offsets, some free and some not."""
    angle = 2.0 * np.pi * np.arange(count) / count
    arm = RADIUS_MM * np.column_stack([np.cos(angle), np.sin(angle)])
    common = rng.normal(0.0, 0.15, (heights, 1, 2)) + rng.normal(0.0, 0.15, (heights, 1, 1)) * arm[:, ::-1] / RADIUS_MM
    return Contacts(
        offset_mm=common + rng.normal(0.0, 0.03, (heights, count, 2)),
        arm_mm=np.broadcast_to(arm, (heights, count, 2)),
        free_mm=np.full((heights, count), 0.15),
        tan_phi=np.ones((heights, count)),
        stiffness_n_per_mm=np.full((heights, count), 20_000.0),
        stud=np.arange(count),
    )


@pytest.mark.parametrize("seed", range(10))
def test_forces_on_the_floating_shaft_balance(seed: int) -> None:
    contacts = ring(np.random.default_rng(seed), heights=20)
    result = solve(contacts, STIFFNESS, RADIUS_MM)
    assert (result.lateral_n > 0.0).any()
    turn = (
        result.float_mm[:, None, 2, None]
        / RADIUS_MM
        * np.stack([-contacts.arm_mm[..., 1], contacts.arm_mm[..., 0]], axis=-1)
    )
    rest = contacts.offset_mm - result.float_mm[:, None, :2] - turn
    push = result.lateral_n[..., None] * rest / np.linalg.norm(rest, axis=2, keepdims=True)
    moment = (contacts.arm_mm[..., 0] * push[..., 1] - contacts.arm_mm[..., 1] * push[..., 0]).sum(axis=1)
    carried = np.column_stack([push.sum(axis=1), moment / RADIUS_MM])
    assert carried == pytest.approx(result.float_mm * STIFFNESS, abs=1e-4)


def test_free_offset_shrinks_along_the_cones_to_the_clearance() -> None:
    depth = np.array([[-0.1], [0.2], [0.9], [1.3], [1.4], [3.0]])
    free, slope = allowance(profile(), depth)
    assert np.isinf(free[0, 0])
    assert free[1:, 0] == pytest.approx([4.95 - 3.4 - 0.2, 4.95 - 3.4 - 0.9, 4.95 - 3.4 - 1.3, 0.15, 0.15])
    assert slope[:, 0] == pytest.approx([0.0, 1.0, 1.0, 1.0, 0.0, 0.0])


def test_the_steeper_of_two_cones_guides_while_both_are_there() -> None:
    free, slope = allowance(profile(lead_in_deg=30.0), np.array([[0.5]]))
    # The blunt tip's edge has gone 0.5 mm down the 45 degree chamfer, the lead-in leaves more room above it.
    assert free[0, 0] == pytest.approx(4.95 - 0.5 - 3.4)
    assert slope[0, 0] == pytest.approx(1.0)


def test_free_offset_is_the_least_distance_of_the_two_profiles() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        entry = profile(lead_in_deg=float(rng.uniform(20, 60)), chamfer_deg=float(rng.uniform(20, 60)))
        depth = float(rng.uniform(0.05, 4.0))
        at = np.linspace(0.0, depth, 20_001)
        hole = entry.hole_mm + entry.tan_chamfer * np.maximum(entry.chamfer_depth_mm - at, 0.0)
        stud = np.minimum(entry.tip_mm + entry.tan_lead_in * (depth - at), entry.stud_mm)
        assert allowance(entry, np.array([[depth]]))[0][0, 0] == pytest.approx((hole - stud).min(), abs=1e-3)


def test_wedging_limit() -> None:
    assert axial_ratio(1.0, 0.15) == pytest.approx(1.15 / 0.85)
    assert axial_ratio(0.0, 0.15) == pytest.approx(0.15)
    assert axial_ratio(0.0, 0.15, inwards=False) == pytest.approx(-0.15)
    assert axial_ratio(1.0, 0.15, inwards=False) == pytest.approx(0.85 / 1.15)
    ratios = axial_ratio(1.0, 0.0), axial_ratio(1.0, 0.5), axial_ratio(1.0, 0.9)
    assert ratios[0] < ratios[1] < ratios[2]
    assert np.isinf(axial_ratio(1.0, 1.0))
    assert np.isinf(axial_ratio(2.0, 0.6))


def test_axial_stiffness_of_a_wedging_joint_is_that_of_the_design_book() -> None:
    # A rigid stud on a 45 degree cone: lateral 1,000 N/mm times the wedge's ratio.
    assert 1000.0 * float(axial_ratio(1.0, 0.15)) == pytest.approx(1350.0, rel=0.01)
