"""The checks on temperature channels, on planted samples."""

from dataclasses import replace

import pytest

from cellctl.ports import RunHeld
from cellctl.recipe import Heat
from cellctl.steps.heat import STUCK_LOOKS, Window, check_channels, check_loop, missing_k
from cellctl.steps.results import HeatSample

RECIPE = Heat()


def sample(time_s: float, warm_c: float = 40.0, power_w: float = 3000.0) -> HeatSample:
    wobble = 0.01 * ((time_s * 7.0) % 3.0)
    return HeatSample(time_s, warm_c + wobble, warm_c - wobble, warm_c + 2 * wobble, 20.0 + wobble, power_w)


def code_of(samples: list[HeatSample]) -> str:
    with pytest.raises(RunHeld) as held:
        check_channels(RECIPE, samples)
        check_loop(RECIPE, samples)
    return held.value.code


def test_plausible_channels_pass() -> None:
    rising = [sample(2.0 * i, 20.0 + i) for i in range(30)]
    check_channels(RECIPE, rising)
    check_loop(RECIPE, rising)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"spigot_1_c": float("nan")}, "temperature_implausible"),
        ({"rotor_c": 900.0}, "temperature_implausible"),
        ({"spigot_1_c": 125.0, "spigot_2_c": 124.0, "pyrometer_c": 124.0}, "over_temperature"),
        ({"spigot_1_c": 60.0}, "temperatures_disagree"),
        ({"pyrometer_c": 80.0}, "temperatures_disagree"),
    ],
)
def test_one_wrong_channel_is_named(change: dict[str, float], code: str) -> None:
    assert code_of([replace(sample(0.0), **change)]) == code


def test_a_channel_that_never_moves_is_stuck() -> None:
    looks = [
        replace(sample(2.0 * i, 30.0 + i), spigot_1_c=40.0, spigot_2_c=41.0 + 0.01 * i) for i in range(STUCK_LOOKS)
    ]
    looks = [replace(look, pyrometer_c=40.0 + 0.01 * i) for i, look in enumerate(looks)]
    assert code_of(looks) == "temperature_stuck"


def test_power_without_rise_is_a_loop_break() -> None:
    looks = [sample(2.0 * i, 20.0) for i in range(60)]
    assert code_of(looks) == "heater_loop_break"


def at_difference(difference_k: float, seconds: range) -> list[HeatSample]:
    return [HeatSample(float(t), 20.0 + difference_k, 20.0 + difference_k, 20.0, 20.0, 500.0) for t in seconds]


def test_a_difference_that_stands_still_beside_its_target_moves_the_set_point() -> None:
    assert missing_k(at_difference(40.0, range(0, 100, 2)), 45.0) == pytest.approx(5.0)


def test_nothing_is_moved_while_it_still_rises_or_was_just_set() -> None:
    rising = [sample(float(t), 20.0 + 0.1 * t) for t in range(0, 100, 2)]
    assert missing_k(rising, 45.0) == 0.0
    assert missing_k(at_difference(40.0, range(0, 30, 2)), 45.0) == 0.0
    assert missing_k([], 45.0) == 0.0


def test_the_target_keeps_away_from_the_ends_of_the_window() -> None:
    assert Window(39.0, 51.0).target_k(45.0) == 45.0
    assert Window(39.0, 41.0).target_k(45.0) == 40.5
    assert Window(46.0, 50.0).target_k(45.0) == 47.0
