"""What a process asks of the system so that it is never kept waiting. What is not granted is told and done without."""

from __future__ import annotations

import ctypes
import gc
import logging
import os

REAL_TIME = 50
"""Of 1 to 99, first in, first out; 50 is also what interrupt threads have."""
_CURRENT_AND_FUTURE = 3
_log = logging.getLogger(__name__)


def never_wait() -> None:
    """Real-time priority, memory locked, no garbage collection by itself."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(REAL_TIME))
    except (OSError, AttributeError) as error:
        _log.warning("no real-time priority: %s", error)
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_CURRENT_AND_FUTURE) != 0:
            _log.warning("memory is not locked: %s", os.strerror(ctypes.get_errno()))
    except (OSError, AttributeError) as error:
        _log.warning("memory is not locked: %s", error)
