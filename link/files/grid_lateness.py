"""How late a stream was against its even grid, read off the times alone at which its setpoints were sent.

An estimate from a log; the streamer counts its own against its own deadlines (`link.clock.TickLateness`).

The streamer serves ticks on an even grid and never catches up what it missed, so a time lies on the grid, or after it.
Which grid is not known: its rate is near that of most steps, and both rate and phase are taken by which all setpoints
together are least late. One setpoint out of place, however far, cannot move that.
"""

from __future__ import annotations

import numpy as np

from planner.arrays import Array

EARLY_SHARE = 0.1
"""Of a period: so much before the grid, a setpoint counts as punctual, not as late by nearly a period."""
RATE_SHARE = 0.2
"""Whole rates are tried so far from that of the steps, which lateness that comes and goes makes look shorter."""
_TRIED = 20_000


def grid_lateness_ms(time_s: Array) -> Array:
    """How late each of two or more setpoints is, below one period: missed ticks show as gaps, not as lateness.

    ``time_s`` rises. The rate is a whole number of setpoints a second where one fits better than that of the steps.
    """
    # Of the shorter steps: the longer ones may hold missed ticks.
    near_hz = 1.0 / max(1e-6, float(np.quantile(np.diff(time_s), 0.3)))
    low, high = int(np.ceil((1.0 - RATE_SHARE) * near_hz)), int((1.0 + RATE_SHARE) * near_hz)
    after_s = time_s - time_s[0]
    some_s = after_s[:: max(1, len(after_s) // _TRIED)]
    _, rate_hz = min((_phase(some_s * rate)[1], rate) for rate in [near_hz, *map(float, range(max(1, low), high + 1))])
    phase, _ = _phase(after_s * rate_hz)
    late = np.mod(after_s * rate_hz - phase + EARLY_SHARE, 1.0) - EARLY_SHARE
    return np.asarray(np.maximum(late, 0.0)) / rate_hz * 1e3


def _phase(periods: Array) -> tuple[float, float]:
    """The place within a period that leaves the least lateness, and its mean, in periods."""
    order = np.sort(np.mod(periods, 1.0))
    # Those before the k-th, taken as phase, are late by nearly a period: the mean is that of all - phase + k / n.
    late = order.mean() - order + np.arange(len(order)) / len(order)
    best = int(late.argmin())
    return float(order[best]), float(late[best])
