"""Items in worker processes: order, one numerical thread, errors, the end."""

from __future__ import annotations

import math
import os

import pytest

from cellctl.studies.pool import map_in_processes
from hal.errors import WorkerError


def test_results_come_in_the_order_of_the_items() -> None:
    items = list(range(20))
    assert list(map_in_processes(math.sqrt, items, workers=2)) == [math.sqrt(item) for item in items]


def test_a_worker_has_one_numerical_thread() -> None:
    names = ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"]
    assert list(map_in_processes(os.getenv, names, workers=1)) == ["1", "1"]


def test_what_the_function_raises_is_raised_here() -> None:
    results = map_in_processes(math.sqrt, [4.0, -1.0, 9.0], workers=1)
    assert next(results) == 2.0
    with pytest.raises(ValueError, match="math domain"):
        next(results)


def test_a_worker_that_dies_is_an_error() -> None:
    with pytest.raises(WorkerError, match="exit code 3"):
        list(map_in_processes(os._exit, [3], workers=1))


def test_results_that_nobody_wants_any_more_are_not_computed_on() -> None:
    results = map_in_processes(math.sqrt, range(500), workers=1)
    assert next(results) == 0.0
    results.close()
    with pytest.raises(StopIteration):
        next(results)
