"""What a process asks of the system so that it is not kept waiting. What is not granted is told and done without."""

from __future__ import annotations

import ctypes
import gc
import logging
import os

_CURRENT_AND_FUTURE = 3
_log = logging.getLogger(__name__)


def real_time(priority: int) -> None:
    """Before every ordinary process, first in, first out (1 to 99, interrupt threads have 50); not for children."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except (OSError, AttributeError) as error:
        _log.warning("no real-time priority: %s", error)


def never_paused() -> None:
    """Memory locked, no garbage collection by itself."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_CURRENT_AND_FUTURE) != 0:
            _log.warning("memory is not locked: %s", os.strerror(ctypes.get_errno()))
    except (OSError, AttributeError) as error:
        _log.warning("memory is not locked: %s", error)
