"""The clock of a log set right by the vehicle's: the ground's may be stepped, and a stamp may be damaged.

Records stand in a log in the order they came. Where their stamps go back, or leap, the vehicle's boot clock
(``time_boot_ms`` of what it sends) tells by how much the time truly went on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.arrays import Array, Indices

BACK_S = 0.01
LEAP_S = 1.0
"""A flight's log has many records a second: no record for so long is a hole, a pause or a stepped clock."""
STEP_S = 1.0
"""Stamps of the ground and of the vehicle part by less while frames are on their way."""


@dataclass(frozen=True)
class LogClock:
    """``time_s`` of each record, never falling; ``steps``: (record, by how many seconds the ground's clock was stepped
    there); ``strays``: stamps out of line with those before and after; ``leaps``: records that come after a hole."""

    time_s: Array
    steps: tuple[tuple[int, float], ...]
    strays: int
    leaps: tuple[int, ...]


def set_right(stamp_s: Array, witness: Indices, boot_s: Array) -> LogClock:
    """From the records' stamps, and the vehicle's clock ``boot_s`` in the records ``witness`` (rising)."""
    time_s, strays = _without_strays(stamp_s)
    went_s = np.diff(time_s)
    odd = [int(at) + 1 for at in np.flatnonzero((went_s < -BACK_S) | (went_s > LEAP_S))]
    brackets: dict[int, list[int]] = {}
    for record in odd:
        brackets.setdefault(int(np.searchsorted(witness, record)), []).append(record)
    steps: list[tuple[int, float]] = []
    for after, records in sorted(brackets.items()):
        # Of several between two words of the vehicle, the widest is the step.
        widest = max(records, key=lambda r: abs(float(went_s[r - 1])))
        by_s = _stepped_by_s(time_s, witness, boot_s, after, float(went_s[widest - 1]))
        if abs(by_s) > (BACK_S if went_s[widest - 1] < 0.0 else STEP_S):
            steps.append((widest, by_s))
    shift = np.zeros(len(time_s))
    for first, by_s in steps:
        shift[first:] += by_s
    right_s = np.maximum.accumulate(time_s - shift) if len(time_s) else time_s
    leaps = np.flatnonzero(np.diff(right_s) > LEAP_S) + 1
    return LogClock(right_s, tuple(steps), strays, tuple(int(r) for r in leaps))


def _stepped_by_s(time_s: Array, witness: Indices, boot_s: Array, after: int, went_s: float) -> float:
    """What the stamps went on by more than the vehicle's clock did, about a place where they are odd."""
    if 0 < after < len(witness):
        vehicle_s = float(boot_s[after] - boot_s[after - 1])
        if vehicle_s >= -STEP_S:
            by_s = float(time_s[witness[after]] - time_s[witness[after - 1]]) - vehicle_s
            return by_s if abs(by_s) > STEP_S else min(0.0, went_s)
    # Nobody to ask, or the vehicle restarted: time does not go back, and a leap may be a pause.
    return min(0.0, went_s)


def _without_strays(stamp_s: Array) -> tuple[Array, int]:
    """Stamps out of line with both neighbours, which agree, taken as the one's before."""
    time_s = np.array(stamp_s, dtype=float)
    if len(time_s) < 3:
        return time_s, 0
    before, here, after = time_s[:-2], time_s[1:-1], time_s[2:]
    agree = (after - before >= -BACK_S) & (after - before <= LEAP_S)
    stray = np.flatnonzero(agree & ((here < before - BACK_S) | (here > after + BACK_S))) + 1
    time_s[stray] = time_s[stray - 1]
    count = len(stray)
    if time_s[0] > time_s[1] + BACK_S or time_s[1] - time_s[0] > 60.0:
        time_s[0], count = time_s[1], count + 1
    if time_s[-1] < time_s[-2] - BACK_S or time_s[-1] - time_s[-2] > 60.0:
        time_s[-1], count = time_s[-2], count + 1
    return time_s, count
