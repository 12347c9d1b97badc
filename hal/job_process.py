"""One worker process seen from its parent. Blocking: `hal.jobs` calls it from a thread."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from multiprocessing.connection import Connection
from typing import Any

from hal.errors import WorkerError
from hal.job_channel import receive, send, shared_file

START_S = 60.0
"""How long a worker may take to import what it needs."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "BLIS_NUM_THREADS")


class WorkerProcess:
    """Starts at once; is given one job at a time. All calls from one thread, `interrupt` from any."""

    def __init__(self, modules: tuple[str, ...]) -> None:
        ours, theirs = socket.socketpair()
        self._connection = Connection(ours.detach())
        self._inbox, self._outbox = shared_file("cellctl-inbox"), shared_file("cellctl-outbox")
        descriptors = (theirs.fileno(), self._inbox, self._outbox)
        environment = os.environ | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": os.pathsep.join(sys.path)}
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hal.job_worker", *map(str, descriptors), str(os.getpid()), *modules],
                pass_fds=descriptors,
                env=environment,
                stdin=subprocess.DEVNULL,
                # An interrupt from the terminal is for the parent, which ends its workers in order.
                start_new_session=True,
            )
        self._ready = False
        self._ended = False

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def dead(self) -> bool:
        """Whether it can run no further job."""
        return self._ended or self._process.poll() is not None

    def call(self, job: object, deadline_s: float) -> tuple[bool, Any]:
        """Whether the job succeeded, and its value or a `hal.job_channel.Raised`.

        Raises WorkerError when the worker died or was late; it has been ended then. What cannot be pickled raises
        here and leaves the worker as it was.
        """
        try:
            if not self._ready:
                self._answer(START_S, "did not start")
                self._ready = True
            send(self._connection, self._inbox, job)
            succeeded, value = self._answer(deadline_s, "was late")
        except (EOFError, OSError) as error:
            self.end()
            raise WorkerError(f"the worker process died (exit code {self._process.returncode})") from error
        return bool(succeeded), value

    def interrupt(self) -> None:
        """Make a call in flight fail at once."""
        self._process.kill()

    def end(self) -> None:
        """Kill, reap, and free what it held. May be called twice."""
        if self._ended:
            return
        self._ended = True
        self._process.kill()
        self._process.wait()
        self._connection.close()
        os.close(self._inbox)
        os.close(self._outbox)

    def _answer(self, seconds: float, what: str) -> Any:
        if not self._connection.poll(seconds):
            self.end()
            raise WorkerError(f"the worker process {what}: no answer within {seconds:g} s")
        return receive(self._connection, self._outbox)
