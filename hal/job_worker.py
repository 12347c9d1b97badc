"""The worker process: ``python -m hal.job_worker SOCKET INBOX OUTBOX PARENT [MODULE...]``. Started by `hal.jobs`.

It imports the given modules, says that it is ready, then runs one job after the other until the socket closes. It runs
at low priority and ends by itself when its parent is gone.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import sys
import threading
import time
import traceback
from multiprocessing.connection import Connection
from typing import Any

from hal.job_channel import Raised, receive, send

NICENESS = 10
PARENT_CHECK_S = 1.0


def main(arguments: list[str]) -> None:
    """Serve jobs until the parent hangs up."""
    socket, inbox, outbox, parent = (int(argument) for argument in arguments[:4])
    threading.Thread(target=_end_with_parent, args=(parent,), daemon=True).start()
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    for module in arguments[4:]:
        importlib.import_module(module)
    with Connection(socket) as connection, contextlib.suppress(EOFError, BrokenPipeError, ConnectionResetError):
        send(connection, outbox, "ready")
        while True:
            _answer(connection, inbox, outbox)


def _answer(connection: Connection, inbox: int, outbox: int) -> None:
    try:
        func, args = receive(connection, inbox)
    except EOFError:
        raise
    except Exception as error:  # the job cannot be read here, e.g. its function is not importable
        answer: tuple[bool, Any] = False, _raised(error)
    else:
        answer = _run(func, args)
        # Nothing of a job may outlive it, neither its arrays.
        del func, args
    try:
        send(connection, outbox, answer)
    except OSError:  # the parent is gone
        raise
    except Exception as error:  # the result cannot travel
        send(connection, outbox, (False, _raised(error)))


def _run(func: Any, args: tuple[Any, ...]) -> tuple[bool, Any]:
    try:
        return True, func(*args)
    except Exception as error:
        return False, _raised(error)


def _raised(error: BaseException) -> Raised:
    trace = "in the worker process:\n" + "".join(traceback.format_exception(error))
    raised = Raised(type(error), error.args, dict(error.__dict__), trace)
    try:
        pickle.loads(pickle.dumps(raised))
    except Exception:  # an exception that carries something that cannot travel comes home as its text
        return Raised(RuntimeError, (f"{type(error).__qualname__}: {error}",), {}, trace)
    return raised


def _end_with_parent(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_CHECK_S)
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
