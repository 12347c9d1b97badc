"""Sockets against studs and nuts: contact force, facing, hex."""

import numpy as np
import pytest

from hal.fake.joints.gun_bench import GunBench, facing, fits, force_n, misfit_deg
from tests.hal.fake.closed_joint import GEOMETRY

BENCH = GunBench()


def test_contact_force_has_an_air_slide_a_spring_and_a_stop() -> None:
    feed = np.array([64.9, 65.0, 90.0, 92.0, 102.0, 102.1])
    force = force_n(BENCH, feed, 90.0)
    assert force == pytest.approx([0.0, 2.0, 2.0, 12.0, 62.0, 262.0])


def test_each_gun_faces_its_stud_and_none_between() -> None:
    stud_mm = GEOMETRY.pattern_mm("shaft")
    assert [facing(BENCH, stud_mm, 120.0, angle) for angle in (0.0, 10.0, 180.0, 350.0, 360.0)] == [0, 1, 18, 35, 0]
    assert facing(BENCH, stud_mm, 120.0, 5.0) is None


def test_a_gun_more_than_a_millimetre_off_the_axis_cannot_engage() -> None:
    stud_mm = GEOMETRY.pattern_mm("shaft")
    assert facing(BENCH, stud_mm, 120.0, np.degrees(0.95 / 120.0)) == 0
    assert facing(BENCH, stud_mm, 120.0, np.degrees(1.05 / 120.0)) is None


def test_the_socket_drops_over_the_hex_within_its_play() -> None:
    assert misfit_deg(BENCH, 20.0, 0.0) == 20.0 and misfit_deg(BENCH, 0.0, 20.0) == 40.0
    assert fits(BENCH, 62.0, 0.0) and fits(BENCH, 58.0, 0.0) and fits(BENCH, 0.0, 0.0)
    assert not fits(BENCH, 3.0, 0.0) and not fits(BENCH, 30.0, 0.0)
