"""Random stops of the whole cell in virtual time: safe within the deadline, nothing left, the record whole."""

from __future__ import annotations

from random import Random

import pytest

from tests.journeys.stops import stopped
from tests.journeys.twin_runs import RememberedJobs

QUICK, ALL = 40, 300


@pytest.fixture(scope="module")
def jobs() -> RememberedJobs:
    return RememberedJobs()


@pytest.mark.parametrize("seed", range(QUICK))
def test_a_stop_at_a_random_instant(seed: int, jobs: RememberedJobs) -> None:
    stopped(Random(seed), jobs)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(QUICK, ALL))
def test_more_stops_at_random_instants(seed: int, jobs: RememberedJobs) -> None:
    stopped(Random(seed), jobs)
