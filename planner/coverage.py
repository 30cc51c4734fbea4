"""When a station covers the vehicle: roots of polynomials, not samples.

On one segment the squared distance to a station less the squared range is a polynomial of degree 2 n in Bernstein
form. The vehicle leaves the range where that changes sign upwards; where it only touches zero the range is not left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner import bezier
from planner.trajectory import Trajectory

Array = NDArray[np.float64]

# An excursion of less than this is rounding: a vehicle that rides along the very edge of a range stays inside it.
SLACK_M = 1e-6


def range_excess(trajectory: Trajectory, segment: int, station_m: Array, range_m: float) -> Array:
    """Bernstein coefficients ``(2 n + 1,)`` of |u(t) - O|^2 - R^2 on one segment, in m^2; negative inside."""
    offset = trajectory.control_points_m[segment] - station_m
    squares = [bezier.product(offset[:, axis], offset[:, axis]) for axis in range(3)]
    return np.asarray(np.sum(squares, axis=0)) - range_m**2


def cone_excess(
    trajectory: Trajectory, segment: int, station_m: Array, min_elevation_deg: float, slack_m: float
) -> list[Array]:
    """Polynomials that are at most zero while the vehicle is above a station's lowest elevation angle.

    The height below the station's plane ``(n + 1,)`` in m, and slope^2 (x^2 + y^2) - height^2 ``(2 n + 1,)`` in m^2.
    ``slack_m`` lowers the cone.
    """
    offset = trajectory.control_points_m[segment] - station_m
    height = offset[:, 2] + slack_m
    slope = float(np.tan(np.radians(min_elevation_deg)))
    squares = [slope**2 * bezier.product(offset[:, axis], offset[:, axis]) for axis in range(2)]
    return [-height, np.asarray(squares[0] + squares[1] - bezier.product(height, height))]


def coverage_window(
    trajectory: Trajectory,
    station_m: Array,
    range_m: float,
    around_s: float,
    *,
    min_elevation_deg: float | None = None,
    slack_m: float = SLACK_M,
) -> tuple[float, float]:
    """The longest span ``(start_s, end_s)`` holding ``around_s`` in which the vehicle stays inside the range.

    The range is taken ``slack_m`` larger. ``min_elevation_deg`` (none when negative) narrows it to a cone. Ends are
    0 and the mission time where it is never left; a vehicle outside at ``around_s`` gives the empty span
    ``(around_s, around_s)``.
    """

    reach = np.linalg.norm(trajectory.control_points_m - station_m, axis=-1).max(axis=1)

    def excess(segment: int) -> list[Array]:
        if min_elevation_deg is None and reach[segment] <= range_m + slack_m:
            return []  # by the convex hull property
        polynomials = [range_excess(trajectory, segment, station_m, range_m + slack_m)]
        if min_elevation_deg is not None and min_elevation_deg >= 0.0:
            polynomials += cone_excess(trajectory, segment, station_m, min_elevation_deg, slack_m)
        return polynomials

    knots, durations = trajectory.knots_s, trajectory.durations_s
    around_s = float(np.clip(around_s, 0.0, trajectory.duration_s))
    at = int(trajectory.segment_at(around_s))
    within = float(np.clip((around_s - knots[at]) / durations[at], 0.0, 1.0))
    if any(_part(p, within, ahead=True)[0] > 0.0 for p in excess(at)):
        return around_s, around_s
    start, end = 0.0, trajectory.duration_s
    for k in range(at, len(trajectory)):
        u = within if k == at else 0.0
        share = _first_exit([_part(p, u, ahead=True) for p in excess(k)])
        if share is not None:
            end = float(knots[k] + (u + (1.0 - u) * share) * durations[k])
            break
    for k in range(at, -1, -1):
        u = within if k == at else 1.0
        share = _first_exit([_part(p, u, ahead=False) for p in excess(k)])
        if share is not None:
            start = float(knots[k] + u * (1.0 - share) * durations[k])
            break
    return min(start, around_s), max(end, around_s)


def _part(coefficients: Array, u: float, *, ahead: bool) -> Array:
    """The polynomial on [u, 1], or on [0, u] and read backwards: both begin at ``u``."""
    if u == (0.0 if ahead else 1.0):
        return coefficients if ahead else coefficients[::-1]
    left, right = bezier.split(coefficients[:, None], u)
    return np.asarray(right[:, 0] if ahead else left[::-1, 0])


def _first_exit(polynomials: list[Array]) -> float | None:
    """The first ``u`` of [0, 1] at which one of the polynomials turns positive; None when none does."""
    exits = []
    for coefficients in polynomials:
        nonzero = coefficients[coefficients != 0.0]
        if not len(nonzero) or nonzero.max() < 0.0:
            continue
        if nonzero[0] > 0.0:
            exits.append(0.0)
            continue
        exits += bezier.roots(coefficients)[:1]
    return min(exits, default=None)
