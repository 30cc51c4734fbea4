"""The curve: a piecewise Bézier trajectory in the planning plane. There is no second one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner import bezier
from planner.arrays import Array, Indices
from planner.errors import ProblemError

# Degree of the pieces that this planner makes, as in the paper: position, velocity and acceleration at both ends fix a
# piece. `Trajectory` itself takes any degree.
DEGREE = 5


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A piecewise Bézier curve, linear in time inside each segment (paper equations (2) and (5)).

    ``control_points_m`` is ``(S, n + 1, 3)``: east, north, altitude of the planning frame.
    ``durations_s`` is ``(S,)``, all positive. ``station_index`` is ``(S,)``: which station of the problem is
    in control. Neighbouring segments of one station are one leg.

    Raises `ProblemError` for shapes that do not fit or values that are not finite.
    """

    control_points_m: Array
    durations_s: Array
    station_index: Indices

    def __post_init__(self) -> None:
        points = np.array(self.control_points_m, dtype=float)
        durations = np.array(self.durations_s, dtype=float)
        stations = np.array(self.station_index, dtype=np.int64)
        if points.ndim != 3 or points.shape[0] < 1 or points.shape[1] < 2 or points.shape[2] != 3:
            raise ProblemError(f"control_points_m must be (S, n + 1, 3), not {points.shape}")
        if durations.shape != points.shape[:1] or stations.shape != points.shape[:1]:
            raise ProblemError("durations_s and station_index must have one entry per segment")
        if not (np.isfinite(points).all() and np.isfinite(durations).all() and (durations > 0).all()):
            raise ProblemError("control points must be finite and durations positive")
        for array in (points, durations, stations):
            array.setflags(write=False)
        object.__setattr__(self, "control_points_m", points)
        object.__setattr__(self, "durations_s", durations)
        object.__setattr__(self, "station_index", stations)

    @property
    def degree(self) -> int:
        """Degree ``n`` of every segment."""
        return int(self.control_points_m.shape[1] - 1)

    def __len__(self) -> int:
        return len(self.durations_s)

    @cached_property
    def knots_s(self) -> Array:
        """Times of the joints, ``(S + 1,)``: 0 at the start, the mission time at the end."""
        return np.concatenate([[0.0], np.cumsum(self.durations_s)])

    @property
    def duration_s(self) -> float:
        """The mission time."""
        return float(self.knots_s[-1])

    @cached_property
    def leg_index(self) -> Indices:
        """``(S,)``: 0 for the first station's segments, 1 for the next one's, and so on."""
        changes = np.diff(self.station_index) != 0
        return np.concatenate([[0], np.cumsum(changes)]).astype(np.int64)

    @cached_property
    def handover_times_s(self) -> Array:
        """``(L - 1,)``: when the next station takes control."""
        times: Array = self.knots_s[1:-1][np.diff(self.station_index) != 0]
        return times

    @property
    def sequence(self) -> tuple[int, ...]:
        """Station indices in flight order, one per leg."""
        first = np.concatenate([[True], np.diff(self.station_index) != 0])
        return tuple(int(i) for i in self.station_index[first])

    def segment_at(self, time_s: Array | float) -> Indices:
        """Segment in force at each time: the later one at a joint, the last one at the end. Clamped outside."""
        index = np.searchsorted(self.knots_s, np.asarray(time_s, dtype=float), side="right") - 1
        return np.clip(index, 0, len(self) - 1)

    def derivative_control_points(self, order: int) -> Array:
        """Control points of the ``order``-th derivative by time, ``(S, n + 1 - order, 3)``, m/s^order.

        Order 1 is Q of paper equation (9), order 2 K of equation (11), order 3 the jerk.
        """
        return bezier.derivative(self.control_points_m, order) / self.durations_s[:, None, None] ** order

    def evaluate(self, time_s: Array | float, order: int = 0) -> Array:
        """Position (m), or its ``order``-th derivative by time, ``(..., 3)`` at times ``(...)``, clamped."""
        time = np.clip(np.asarray(time_s, dtype=float), 0.0, self.duration_s)
        segment = self.segment_at(time)
        u = np.clip((time - self.knots_s[segment]) / self.durations_s[segment], 0.0, 1.0)
        points = self.control_points_m if order == 0 else self.derivative_control_points(order)
        return bezier.evaluate(points[segment], u)

    def split(self, times_s: Sequence[float]) -> Trajectory:
        """The same curve with more joints at ``times_s``; times outside, or within 1 ns of a joint, are ignored."""
        points, durations, stations = [], [], []
        for k in range(len(self)):
            start, duration = self.knots_s[k], self.durations_s[k]
            inner = sorted({float(t) for t in times_s if start + 1e-9 < t < start + duration - 1e-9})
            rest, begin = self.control_points_m[k], float(start)
            for t in inner:
                left, rest = bezier.split(rest, (t - begin) / (start + duration - begin))
                points.append(left)
                durations.append(t - begin)
                stations.append(self.station_index[k])
                begin = t
            points.append(rest)
            durations.append(float(start + duration - begin))
            stations.append(self.station_index[k])
        return Trajectory(np.array(points), np.array(durations), np.array(stations))

    def elevate(self, degree: int) -> Trajectory:
        """The same curve at a higher degree."""
        return Trajectory(bezier.elevate(self.control_points_m, degree), self.durations_s, self.station_index)

    def scale_time(self, factor: float) -> Trajectory:
        """The same path flown ``factor`` times slower: speeds divide by it, accelerations by its square."""
        return Trajectory(self.control_points_m, self.durations_s * factor, self.station_index)

    def path_length_m(self) -> float:
        """Length of the path, by Gauss-Legendre quadrature of the speed on 16 parts of every segment."""
        nodes, weights = np.polynomial.legendre.leggauss(8)
        parts = 16
        u = ((np.arange(parts)[:, None] + 0.5 * (nodes + 1.0)) / parts).ravel()
        weight = np.tile(weights, parts) / (2.0 * parts)
        basis = bezier.bernstein(self.degree - 1, u)
        velocity = np.einsum("uj,sjd->sud", basis, bezier.derivative(self.control_points_m))
        return float((np.linalg.norm(velocity, axis=-1) @ weight).sum())
