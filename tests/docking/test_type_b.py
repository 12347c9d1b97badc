"""Type B covariance against the same errors made in a simulated world."""

import numpy as np
import pytest

from cellctl.docking.alignment import Station
from cellctl.docking.joint import basis_of, joint_of, offsets_at, seat
from cellctl.docking.type_b import causes, rigid
from cellctl.kinematics import AxesPosition

from .parts import HEIGHT, calibration, measurement, pose, recipe

ANGLES = recipe().pattern.angles()
MIRRORED = recipe().part("rotor").angles_deg
HOME = AxesPosition(0, 0, 0, 0)
SEATED, ENTRY = Station(0.0), Station(32.0)
STILL = {"sigma_direction_deg": 0.0, "sigma_position_mm": 0.0, "sigma_roll_deg": 0.0}


def covariance(at=HOME, station=SEATED, **updates):
    cal = calibration()
    quiet = {
        "views": {
            name: view.model_copy(update={"sigma_rotation_deg": 0.0, "sigma_translation_mm": 0.0})
            for name, view in cal.views.items()
        },
        "table_axis": cal.table_axis.model_copy(update=STILL),
        "jack_line": cal.jack_line.model_copy(update=STILL),
        "stage": cal.stage.model_copy(
            update={"sigma_position_mm": 0.0, "sigma_table_deg": 0.0, "sigma_encoder_deg": 0.0}
        ),
        "scanner": cal.scanner.model_copy(update={"sigma_scale": 0.0, "sigma_ripple_mm": 0.0}),
    }
    cal = cal.model_copy(update=quiet | updates)
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    joint = joint_of(rotor, measurement("hole", pose(), ANGLES), tuple(range(36)), cal, HOME)
    target = seat(joint, cal, at, 0.0)
    return rigid(causes(joint, cal, HOME, target, station), offsets_at(joint, cal, target, station)[1])


def test_no_uncertainty_no_covariance() -> None:
    np.testing.assert_allclose(covariance(), 0.0, atol=1e-20)


def test_jack_direction_acts_over_the_travel() -> None:
    line = calibration().jack_line.model_copy(update=STILL | {"sigma_direction_deg": 0.01})
    sigma = np.sqrt(np.diag(covariance(jack_line=line)))
    assert sigma[:2] == pytest.approx(HEIGHT * np.radians(0.01), rel=1e-3)
    assert sigma[2] == pytest.approx(0.0, abs=1e-8)


def test_where_studs_enter_the_jack_has_not_gone_all_the_way() -> None:
    line = calibration().jack_line.model_copy(update=STILL | {"sigma_direction_deg": 0.01})
    sigma = np.sqrt(np.diag(covariance(station=ENTRY, jack_line=line)))
    assert sigma[:2] == pytest.approx((HEIGHT - ENTRY.gap_mm) * np.radians(0.01), rel=1e-3)


def test_view_rotation_acts_at_the_distance_of_what_enters() -> None:
    quiet = {"sigma_rotation_deg": 0.0, "sigma_translation_mm": 0.0}
    views = {name: view.model_copy(update=quiet) for name, view in calibration().views.items()}
    views["rotor"] = views["rotor"].model_copy(update={"sigma_rotation_deg": 0.01})
    sigma = np.sqrt(np.diag(covariance(station=ENTRY, views=views)))
    assert sigma[:2] == pytest.approx((350.0 - ENTRY.gap_mm) * np.radians(0.01), rel=1e-3)


def test_jack_straightness_is_sideways() -> None:
    line = calibration().jack_line.model_copy(update=STILL | {"sigma_position_mm": 0.005})
    assert np.sqrt(np.diag(covariance(jack_line=line))) == pytest.approx([0.005, 0.005, 0.0])


def test_view_rotation_acts_at_the_distance_of_the_part() -> None:
    views = dict(calibration().views)
    quiet = {"sigma_rotation_deg": 0.0, "sigma_translation_mm": 0.0}
    views["shaft"] = views["shaft"].model_copy(update=quiet)
    views["rotor"] = views["rotor"].model_copy(update=quiet | {"sigma_rotation_deg": 0.01})
    sigma = np.sqrt(np.diag(covariance(views=views)))
    assert sigma[:2] == pytest.approx(350.0 * np.radians(0.01), rel=1e-3)
    assert np.degrees(sigma[2]) == pytest.approx(0.01, rel=1e-3)


def test_stage_and_table_pass_through() -> None:
    stage = calibration().stage.model_copy(
        update={"sigma_position_mm": 0.004, "sigma_table_deg": 0.003, "sigma_encoder_deg": 0.0}
    )
    sigma = np.sqrt(np.diag(covariance(stage=stage)))
    assert sigma[:2] == pytest.approx(0.004)
    assert np.degrees(sigma[2]) == pytest.approx(0.003)


def test_an_eccentric_encoder_acts_over_the_turn() -> None:
    stage = calibration().stage.model_copy(update={"sigma_position_mm": 0.0, "sigma_encoder_deg": 0.003})
    for turn, expected in ((0.0, 0.0), (0.1, 0.003 * np.radians(0.1)), (60.0, 0.003), (180.0, 0.006)):
        sigma = np.sqrt(np.diag(covariance(AxesPosition(0, 0, 0, turn), stage=stage)))
        assert np.degrees(sigma[2]) == pytest.approx(expected, rel=1e-3, abs=1e-12)
        assert sigma[:2].max() < 1e-9


def test_the_jack_turns_what_it_carries() -> None:
    line = calibration().jack_line.model_copy(update=STILL | {"sigma_roll_deg": 0.002})
    sigma = np.sqrt(np.diag(covariance(jack_line=line)))
    assert np.degrees(sigma[2]) == pytest.approx(0.002)
    assert sigma[:2].max() < 1e-9


def test_the_scale_of_the_scanner_cancels_between_the_two_views() -> None:
    scanner = calibration().scanner.model_copy(update={"sigma_scale": 1e-3, "sigma_ripple_mm": 0.0})
    assert np.sqrt(np.diag(covariance(scanner=scanner)))[:2].max() < 1e-4


def test_jacobian_is_the_derivative_of_the_offsets() -> None:
    cal = calibration()
    rotor = measurement("stud", pose(z=HEIGHT, down=True), MIRRORED)
    joint = joint_of(rotor, measurement("hole", pose(), ANGLES), tuple(range(36)), cal, HOME)
    at = seat(joint, cal, HOME, 0.0)
    offsets, jacobian = offsets_at(joint, cal, at, Station(32.0))
    turned, _ = offsets_at(joint, cal, AxesPosition(1e-3, -2e-3, at.z_mm, 1e-4), Station(32.0))
    step = np.array([1e-3, -2e-3, np.radians(1e-4)])
    np.testing.assert_allclose(turned - offsets, jacobian @ step, atol=1e-8)
    np.testing.assert_allclose(basis_of(cal), np.eye(3), atol=1e-12)
