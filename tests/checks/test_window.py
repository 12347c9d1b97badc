import pytest

from cellctl.checks.heating import growth_mm, temperature_window
from cellctl.recipe import parse_recipe
from tests.test_recipe import lpt


def test_the_window_has_two_sides() -> None:
    window = temperature_window(parse_recipe(lpt()))
    assert window is not None
    assert window.low_k == pytest.approx((0.060 + 0.005 + 0.020) / (12.5e-6 * 180.0))
    # 98.8 % of all 36 stay free at 60 K, 23 % at 80 K: three sigma end just below 60 K.
    assert 55.0 < window.high_k < 60.0


@pytest.mark.parametrize(("difference_k", "grown_mm"), [(40.0, 0.060), (60.0, 0.090), (80.0, 0.120), (100.0, 0.150)])
def test_a_radius_of_120_mm_grows_as_the_table_says(difference_k: float, grown_mm: float) -> None:
    assert growth_mm(parse_recipe(lpt()), difference_k) == pytest.approx(grown_mm)


def test_without_gates_and_scatter_all_clearance_may_be_used() -> None:
    text = lpt(
        ("gate_xy_mm = 0.04", "gate_xy_mm = 1e-9"),
        ("gate_theta_deg = 0.03", "gate_theta_deg = 1e-9"),
        ("radial_clearance_mm = 0.15", "radial_clearance_mm = 0.15\nposition_sigma_mm = 0.0"),
    )
    window = temperature_window(parse_recipe(text))
    assert window is not None
    assert window.high_k == pytest.approx(100.0)


def test_a_cold_joint_has_no_window_and_no_growth() -> None:
    recipe = parse_recipe(lpt(("enabled = true", "enabled = false")))
    assert temperature_window(recipe) is None
    assert growth_mm(recipe, 45.0) == 0.0
