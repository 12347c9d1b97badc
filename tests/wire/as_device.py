"""What every device of the cell must do, as cases to be run on one over the wire."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from tests.contract import test_device as device

DeviceCase = Callable[..., None]
CONNECTED: tuple[DeviceCase, ...] = (
    device.test_it_says_who_it_is,
    device.test_at_rest_it_halts_is_safe_and_rearms,
    device.test_back_from_hanging_it_answers,
    device.test_slow_answers_within_the_deadline_are_still_answers,
    *(partial(device.test_gone_it_fails_at_once, command=command) for command in device.COMMANDS),
    *(
        partial(device.test_hung_it_misses_its_own_deadline_and_can_be_given_up, command=command)
        for command in device.COMMANDS
    ),
)
UNANSWERED: tuple[DeviceCase, ...] = tuple(
    partial(device.test_it_does_not_connect_where_nothing_answers_and_always_closes, kind=kind)
    for kind in ("gone", "hung")
)
