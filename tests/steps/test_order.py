"""Opposite pairs and the star order."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.steps.order import pairs, star
from hal.errors import ConfigError


def equal(count: int) -> tuple[float, ...]:
    return tuple(360.0 * i / count for i in range(count))


def test_thirty_six_joints_are_eighteen_opposite_pairs_each_joint_once() -> None:
    found = pairs(equal(36), "star")
    assert len(found) == 18
    assert sorted([p.a for p in found] + [p.b for p in found]) == list(range(36))
    assert all((p.b - p.a) % 36 == 18 for p in found)


def test_second_pair_of_the_star_lies_across_the_first() -> None:
    first, second = pairs(equal(36), "star")[:2]
    assert 60.0 <= abs(second.table_deg - first.table_deg) <= 120.0


@given(st.integers(min_value=1, max_value=60))
def test_star_is_a_permutation(count: int) -> None:
    assert sorted(star(count)) == list(range(count))


def test_a_joint_without_an_opposite_is_named() -> None:
    with pytest.raises(ConfigError, match=r"angles_deg\[0\]"):
        pairs(equal(5), "star")
