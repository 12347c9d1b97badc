"""Every case that asks for `backend` runs on each of them."""

from __future__ import annotations

import pytest

from tests.contract.backends import BACKENDS, FAKE
from tests.contract.hardware import hardware


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """The backends of the case's own file."""
    if "backend" in metafunc.fixturenames:
        file = metafunc.module.__name__.rsplit(".", 1)[-1]
        metafunc.parametrize(
            "backend", (*BACKENDS.get(file, (FAKE,)), *hardware()), ids=lambda backend: str(backend.name)
        )
