"""Every case that asks for `backend` runs on each of them."""

from __future__ import annotations

import pytest

from tests.contract.backends import BACKENDS, Backend


@pytest.fixture(params=BACKENDS, ids=lambda backend: str(backend.name))
def backend(request: pytest.FixtureRequest) -> Backend:
    made: Backend = request.param
    return made
