"""Jobs: same results inline and in a process, large arrays, errors intact, crash, deadline, cancel, nothing left."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cellctl.vision.part import Refused
from hal.clock import QuickenedLoop, run_virtual
from hal.errors import ConfigError, GuardTripped, WorkerError
from hal.jobs import InlineJobs, Jobs, ProcessJobs


@dataclass(frozen=True)
class Cloud:
    name: str
    points: NDArray[np.float32]


def double(cloud: Cloud) -> Cloud:
    return Cloud(cloud.name + "!", cloud.points * 2)


def several(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return {name: array[::-1] for name, array in arrays.items()}


def raise_this(what: str) -> None:
    if what == "refused":
        raise Refused("features_missing", "3 of 36 holes were not found")
    if what == "config":
        raise ConfigError("too large", place="jack.speed", limit="20", unit="mm/s")
    if what == "guard":
        raise GuardTripped("over force", force_n=12.5)
    raise ValueError(what)


class Unreadable(Exception):
    """Carries what cannot be pickled."""

    def __init__(self) -> None:
        super().__init__("holds a lock", threading.Lock())


def raise_unreadable() -> None:
    raise Unreadable


def unreadable() -> object:
    return threading.Lock()


def write_in_place(array: NDArray[np.float64]) -> float:
    array[:] = 1.0
    return float(array.sum())


def where() -> tuple[int, int, str | None]:
    return os.getpid(), os.nice(0), os.environ.get("OMP_NUM_THREADS")


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def sleep_for(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def imported(module: str) -> bool:
    return module in sys.modules


def in_process(main: Any, **options: Any) -> Any:
    async def whole() -> Any:
        async with ProcessJobs(**options) as jobs:
            return await main(jobs)

    return asyncio.run(whole())


def gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def wait_end(watch: int) -> None:
    """Wait until the process behind a pidfd has ended."""
    ended, _, _ = select.select([watch], [], [], 20.0)
    os.close(watch)
    assert ended


def open_descriptors() -> set[str]:
    return {path.name for path in Path("/proc/self/fd").iterdir()}


def hold(path: str) -> None:
    """Say by a socket that the job has begun, and go on for as long as the other side likes."""
    with socket.socket(socket.AF_UNIX) as line:
        line.connect(path)
        line.recv(1)


@contextlib.asynccontextmanager
async def begun(folder: Path) -> AsyncIterator[tuple[str, asyncio.Event]]:
    """Where `hold` connects to, and what is set when it has."""
    event, path = asyncio.Event(), str(folder / "line")

    async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        event.set()
        await reader.read()
        writer.close()

    async with await asyncio.start_unix_server(connected, path):
        yield path, event


async def twice_the_cloud(jobs: Jobs) -> Cloud:
    points = np.arange(707 * 707 * 3, dtype=np.float32).reshape(707, 707, 3)
    points[5, 7] = np.nan
    return await jobs.run(double, Cloud("a", points), latency_s=0.0)


def test_inline_and_process_give_the_same_cloud() -> None:
    inline, process = run_virtual(twice_the_cloud(InlineJobs())), in_process(twice_the_cloud)
    assert process.name == inline.name == "a!"
    assert process.points.dtype == np.float32
    np.testing.assert_array_equal(process.points, inline.points)
    process.points[0, 0] = 0.0  # what comes back is the caller's own


def test_arrays_of_every_size_and_order_cross_both_ways() -> None:
    rng = np.random.default_rng(3)
    arrays = {
        "none": np.empty((0, 3)),
        "small": rng.normal(size=7),
        "large": rng.normal(size=300_001),
        "fortran": np.asfortranarray(rng.normal(size=(400, 300))),
        "strided": rng.normal(size=(1000, 1000))[::3, ::2],
        "flags": rng.random(200_000) < 0.5,
    }

    async def main(jobs: ProcessJobs) -> list[dict[str, NDArray[Any]]]:
        # The memory grows with the second job and is reused by the third.
        return [await jobs.run(several, part, latency_s=0.0) for part in ({"small": arrays["small"]}, arrays, arrays)]

    first, second, third = in_process(main)
    np.testing.assert_array_equal(first["small"], arrays["small"][::-1])
    for name, array in arrays.items():
        np.testing.assert_array_equal(second[name], array[::-1])
        np.testing.assert_array_equal(third[name], array[::-1])


def test_a_job_works_on_its_own_copy() -> None:
    array = np.zeros(100_000)

    async def main(jobs: ProcessJobs) -> float:
        return await jobs.run(write_in_place, array, latency_s=0.0)

    assert in_process(main) == 100_000.0
    assert not array.any()


@pytest.mark.parametrize("kind", ["inline", "process"])
def test_exceptions_arrive_as_they_were_raised(kind: str) -> None:
    async def main(jobs: Jobs) -> None:
        with pytest.raises(Refused, match="features_missing: 3 of 36") as refused:
            await jobs.run(raise_this, "refused", latency_s=0.0)
        assert (refused.value.code, refused.value.reason) == ("features_missing", "3 of 36 holes were not found")
        with pytest.raises(ConfigError) as config:
            await jobs.run(raise_this, "config", latency_s=0.0)
        assert (config.value.place, config.value.limit, config.value.unit) == ("jack.speed", "20", "mm/s")
        with pytest.raises(GuardTripped) as guard:
            await jobs.run(raise_this, "guard", latency_s=0.0)
        assert guard.value.force_n == 12.5
        with pytest.raises(ValueError, match="plain") as plain:
            await jobs.run(raise_this, "plain", latency_s=0.0)
        if kind == "process":
            assert any("raise_this" in note for note in plain.value.__notes__)

    if kind == "inline":
        run_virtual(main(InlineJobs()))
    else:
        in_process(main)


def test_what_cannot_travel_is_an_error_and_harms_no_later_job() -> None:
    async def main(jobs: ProcessJobs) -> tuple[int, int]:
        before = (await jobs.run(where, latency_s=0.0))[0]
        with pytest.raises(RuntimeError, match=r"Unreadable.*holds a lock"):
            await jobs.run(raise_unreadable, latency_s=0.0)
        with pytest.raises(TypeError, match="pickle"):
            await jobs.run(unreadable, latency_s=0.0)
        with pytest.raises(TypeError, match="pickle"):
            await jobs.run(double, threading.Lock(), latency_s=0.0)
        return before, (await jobs.run(where, latency_s=0.0))[0]

    before, after = in_process(main)
    assert before == after


def test_a_worker_is_another_process_at_low_priority_with_one_thread_and_its_modules() -> None:
    async def main(jobs: ProcessJobs) -> None:
        pid, niceness, threads = await jobs.run(where, latency_s=0.0)
        assert pid != os.getpid()
        assert pid == jobs.worker_pids[0]
        assert niceness >= min(os.nice(0) + 10, 19)
        assert threads == "1"
        assert await jobs.run(imported, "colorsys", latency_s=0.0)

    in_process(main, modules=("colorsys",))


def test_the_spare_takes_over_from_a_worker_that_dies() -> None:
    async def main(jobs: ProcessJobs) -> tuple[int, ...]:
        first, spare = jobs.worker_pids
        with pytest.raises(WorkerError, match=r"died \(exit code -9\)"):
            await jobs.run(die, latency_s=0.0)
        assert (await jobs.run(where, latency_s=0.0))[0] == spare
        assert jobs.worker_pids[0] == spare
        assert jobs.worker_pids[1] not in (first, spare)
        return first, *jobs.worker_pids

    assert all(gone(pid) for pid in in_process(main))


def test_a_worker_killed_while_idle_is_replaced_before_the_next_job_fails() -> None:
    async def main(jobs: ProcessJobs) -> None:
        await jobs.run(where, latency_s=0.0)
        victim, spare = jobs.worker_pids
        watch = os.pidfd_open(victim)
        os.kill(victim, signal.SIGKILL)
        wait_end(watch)
        assert (await jobs.run(where, latency_s=0.0))[0] == spare

    in_process(main)


def test_a_late_worker_is_killed_and_replaced() -> None:
    async def main(jobs: ProcessJobs) -> None:
        await jobs.run(where, latency_s=0.0)
        late, spare = jobs.worker_pids
        with pytest.raises(WorkerError, match=r"was late: no answer within 0\.5 s"):
            await jobs.run(sleep_for, 60.0, latency_s=0.0)
        assert gone(late)
        assert (await jobs.run(where, latency_s=0.0))[0] == spare

    started = time.monotonic()
    # Imported beforehand, so that the deadline is the job's alone.
    in_process(main, deadline_s=0.5, modules=(__name__,))
    assert time.monotonic() - started < 20.0


def test_a_cancelled_job_is_ended_with_its_worker(tmp_path: Path) -> None:
    async def main(jobs: ProcessJobs) -> None:
        await jobs.run(where, latency_s=0.0)
        busy, spare = jobs.worker_pids
        async with begun(tmp_path) as (path, event):
            task = asyncio.create_task(jobs.run(hold, path, latency_s=0.0))
            await event.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
        assert gone(busy)
        assert (await jobs.run(where, latency_s=0.0))[0] == spare

    in_process(main)


def test_closing_fails_the_job_in_flight_and_leaves_nothing(tmp_path: Path) -> None:
    async def main() -> tuple[int, ...]:
        open_before = open_descriptors()
        jobs = ProcessJobs()
        await jobs.start()
        await jobs.run(where, latency_s=0.0)
        pids = jobs.worker_pids
        async with begun(tmp_path) as (path, event):
            in_flight = asyncio.create_task(jobs.run(hold, path, latency_s=0.0))
            queued = asyncio.create_task(jobs.run(where, latency_s=0.0))
            await event.wait()
            await jobs.close()
            await jobs.close()
        for task in (in_flight, queued):
            with pytest.raises(WorkerError):
                await task
        with pytest.raises(WorkerError, match="closed"):
            await jobs.run(where, latency_s=0.0)
        assert open_descriptors() == open_before
        return pids

    threads = set(threading.enumerate())
    pids = asyncio.run(main())
    assert all(gone(pid) for pid in pids)
    assert set(threading.enumerate()) <= threads


def test_workers_end_with_a_parent_that_is_killed(root: Path) -> None:
    """Even in the middle of a job, and nobody was there to close them."""
    program = (
        "import asyncio, time\n"
        "from hal.jobs import ProcessJobs\n"
        "async def main():\n"
        "    jobs = ProcessJobs()\n"
        "    await jobs.start()\n"
        "    await jobs.run(abs, -1, latency_s=0.0)\n"
        "    print(*jobs.worker_pids, flush=True)\n"
        "    await jobs.run(time.sleep, 60.0, latency_s=0.0)\n"
        "asyncio.run(main())\n"
    )

    async def main() -> list[int]:
        parent = await asyncio.create_subprocess_exec(
            sys.executable, "-c", program, cwd=root, stdout=asyncio.subprocess.PIPE
        )
        assert parent.stdout is not None
        pids = [int(word) for word in (await parent.stdout.readline()).split()]
        watches = [os.pidfd_open(pid) for pid in pids]
        parent.kill()
        await parent.wait()
        for watch in watches:
            wait_end(watch)
        return pids

    assert len(asyncio.run(main())) == 2


def test_virtual_time_is_charged_the_latency_and_nothing_else() -> None:
    async def main() -> tuple[float, float]:
        loop = asyncio.get_running_loop()
        jobs = InlineJobs()
        await jobs.run(sleep_for, 0.01, latency_s=0.8)
        after_one = loop.time()
        with pytest.raises(ValueError, match="plain"):
            await jobs.run(raise_this, "plain", latency_s=0.5)
        return after_one, loop.time()

    assert run_virtual(main()) == (pytest.approx(0.8), pytest.approx(1.3))


def test_a_quickened_clock_stands_still_while_a_job_is_in_flight() -> None:
    async def main() -> tuple[float, float]:
        loop = asyncio.get_running_loop()
        async with ProcessJobs() as jobs:
            await jobs.run(where, latency_s=0.0)
            began, began_wall = loop.time(), time.monotonic()
            await jobs.run(sleep_for, 0.3, latency_s=100.0)
            return loop.time() - began, time.monotonic() - began_wall

    with asyncio.Runner(loop_factory=lambda: QuickenedLoop(1000.0)) as runner:
        cell_s, wall_s = runner.run(main())
    # 0.3 s of work would be 300 s of cell time if the clock ran on; what is allowed beyond is the loop's own pace.
    assert wall_s >= 0.3
    assert 100.0 <= cell_s < 100.0 + 1000.0 * (wall_s - 0.3)
