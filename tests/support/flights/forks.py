"""Many endings of one flight: fly to a moment once, then try each ending in a fork of the process.

A flight in virtual time cannot be copied (its procedures are generators), but a process can. A fork costs milliseconds
where flying there anew costs half a second.
"""

from __future__ import annotations

import os
import pickle
import traceback
import warnings
from collections.abc import Callable
from typing import Any


def in_fork(work: Callable[[], Any]) -> Any:
    """What ``work`` returns (picklable), done in a fork: nothing it changes stays. Raises `AssertionError` with its
    traceback when it raises anything."""
    reading, writing = os.pipe()
    with warnings.catch_warnings():
        # Newer Pythons warn of other threads; the fork touches none of theirs.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        try:
            os.close(reading)
            try:
                answer = (True, work())
            except BaseException:
                answer = (False, traceback.format_exc())
            with os.fdopen(writing, "wb") as stream:
                pickle.dump(answer, stream)
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, "rb") as stream:
        data = stream.read()
    os.waitpid(child, 0)
    if not data:
        raise AssertionError("the fork died without an answer")
    good, answer = pickle.loads(data)
    if not good:
        raise AssertionError(f"in a fork:\n{answer}")
    return answer
