"""What holds for every test: nothing is left behind, neither thread nor child process nor shared memory."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from cellctl.__main__ import ONE_THREAD

os.environ.update(dict.fromkeys(ONE_THREAD, "1"))

ROOT = Path(__file__).parents[1]


@pytest.fixture
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """A test that leaves a thread, a child process or a shared-memory file behind fails."""
    threads, shared = set(threading.enumerate()), _shared_memory()
    yield
    left_threads = [t.name for t in threading.enumerate() if t not in threads and not t.daemon]
    left_children = [child.name for child in multiprocessing.active_children()]
    left_shared = sorted(_shared_memory() - shared)
    assert not left_threads, f"threads left behind: {left_threads}"
    assert not left_children, f"processes left behind: {left_children}"
    assert not left_shared, f"shared memory left behind: {left_shared}"


def _shared_memory() -> set[str]:
    """Shared-memory segments of this project; other test workers name theirs by their own process id."""
    folder = Path("/dev/shm")
    return {path.name for path in folder.glob(f"cellctl-{os.getpid()}-*")} if folder.is_dir() else set()
