"""One command has a cell's devices in hand: a second service is sent away, and a killed one stands in nobody's way."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from cellctl.__main__ import main
from hal.errors import DeviceRefused
from hal.owner import sole_user
from tests.dead.processes import cell_in

HOLDER = """
import asyncio, sys
from pathlib import Path
from hal.jobs import ProcessJobs
from hal.owner import sole_user

async def hold():
    with sole_user(Path(sys.argv[1])):
        async with ProcessJobs() as jobs:
            print(*jobs.worker_pids, flush=True)
            await asyncio.Event().wait()

asyncio.run(hold())
"""


@contextmanager
def held(cell: Path, root: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process, with workers of its own, has the cell in hand; killed in the end."""
    command = [sys.executable, "-c", HOLDER, str(cell)]
    with subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline().split()
            yield process
        finally:
            process.kill()


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A wire cell whose devices are not there."""
    path = cell_in(tmp_path).path
    path.write_text(path.read_text(encoding="utf-8").replace('process = "service"', 'process = "in_loop"'))
    return path


@pytest.mark.parametrize("command", ["serve", "run", "calibrate"])
def test_a_second_one_is_sent_away_before_it_touches_a_device(
    tmp_path: Path, root: Path, cell: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    recipe = str(root / "recipes/wire_bench.toml")
    arguments = {
        "serve": ["serve", "--port", "0", "--data", str(tmp_path / "data")],
        "run": ["run", "--recipe", recipe, "--data", str(tmp_path / "data")],
        "calibrate": ["calibrate", "camera", "-o", str(tmp_path / "calibration.toml"), "--recipe", recipe],
    }
    with held(cell, root):
        assert main([*arguments[command], "--cell", str(cell)]) == 3
    assert "cell.toml: another command has this cell's devices in hand" in capsys.readouterr().err


def test_a_killed_one_stands_in_nobodys_way(root: Path, cell: Path) -> None:
    with held(cell, root) as process:
        with pytest.raises(DeviceRefused), sole_user(cell):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
        with sole_user(cell):  # though its workers may live a moment longer
            pass


def test_the_same_cell_by_another_name_is_the_same(root: Path, cell: Path) -> None:
    other = cell.with_name("other.toml")
    other.symlink_to(cell)
    with held(cell, root), pytest.raises(DeviceRefused), sole_user(other):
        pass
    shutil.copy(cell, copy := cell.with_name("copy.toml"))
    with held(cell, root), sole_user(copy):  # only the drives' bus tells of that one
        pass
