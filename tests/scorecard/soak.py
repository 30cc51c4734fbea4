"""Long runs in parts, with a line now and then, so that one cut short leaves a figure.

``SKYRELAY_SOAK_FIRST`` and ``SKYRELAY_SOAK_COUNT`` choose a part of each run's numbers. What is drawn for a number does
not depend on the part.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

FIRST, COUNT = "SKYRELAY_SOAK_FIRST", "SKYRELAY_SOAK_COUNT"


def part(numbers: range) -> range:
    """The part of a run's numbers that the environment chooses; all of them by default."""
    first = int(os.environ.get(FIRST, "0"))
    count = os.environ.get(COUNT)
    return numbers[first:] if count is None else numbers[first : first + int(count)]


def counted(what: str, numbers: range, every: int = 50) -> Iterator[int]:
    """The numbers of `part`, and a line on how many are done (all of them good, or it would have ended)."""
    chosen = part(numbers)
    for done, number in enumerate(chosen, 1):
        yield number
        if done % every == 0 or done == len(chosen):
            print(f"{what}: {done} of {len(numbers)} done", flush=True)
