"""Real-time priority and locked memory for the streaming process."""

from __future__ import annotations

import contextlib
import ctypes
import os

REAL_TIME_PRIORITY = 10
"""Of the flight; the thread that writes its logs is one below."""
_MCL_CURRENT, _MCL_ONFAULT = 1, 4


def raise_priority(priority: int = REAL_TIME_PRIORITY) -> str:
    """Real-time scheduling for this thread where permitted; what was got."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, AttributeError):
        with contextlib.suppress(OSError):
            os.nice(-10)
            return "nice -10"
        return "ordinary"
    return f"SCHED_FIFO {priority}"


def lock_memory() -> str:
    """Keep in memory what is there, so that no tick waits for a disk to bring it back; what was got."""
    try:
        failed = ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_ONFAULT)
    except (OSError, AttributeError) as error:
        return f"not locked ({error})"
    return f"not locked ({os.strerror(ctypes.get_errno())})" if failed else "locked"
