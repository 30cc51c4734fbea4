"""Elevation masks: the cone by hand, and what stands for a station without one."""

from __future__ import annotations

import numpy as np
import pytest

from planner import ProblemError
from planner.coverage.elevation_mask import ElevationMask
from tests.support.missions.problems import make_problem

# None, the horizon, 45 degrees (a slope of 1) and 30 degrees (a slope of 1 / sqrt 3).
MASK = ElevationMask.of_each([None, 0.0, 45.0, 30.0])


def test_slopes_and_kinds() -> None:
    assert MASK.limited.tolist() == [False, True, True, True]
    assert MASK.horizon.tolist() == [False, True, False, False]
    assert MASK.cone.tolist() == [False, False, True, True]
    assert MASK.slope == pytest.approx([0.0, 0.0, 1.0, 1.0 / np.sqrt(3.0)])


def test_how_far_below_the_cone_a_point_is() -> None:
    # 300 m east and 400 m north are 500 m aside; 200 m up that is 300 m below 45 degrees.
    below = MASK.below_m(np.array([300.0, 400.0, 200.0]))
    assert below == pytest.approx([-np.inf, -200.0, 300.0, 500.0 / np.sqrt(3.0) - 200.0])
    assert MASK.lowest_alt_m(np.full(4, 50.0), np.full(4, 500.0)) == pytest.approx(
        [-np.inf, 50.0, 550.0, 50.0 + 500.0 / np.sqrt(3.0)]
    )


def test_how_far_aside_a_station_hears() -> None:
    assert MASK.reach_m(np.array(100.0)) == pytest.approx([np.inf, np.inf, 100.0, 100.0 * np.sqrt(3.0)])
    assert MASK.reach_m(np.array(0.0)) == pytest.approx([np.inf, np.inf, 0.0, 0.0])
    assert MASK.reach_m(np.array(-1.0)) == pytest.approx([np.inf, 0.0, 0.0, 0.0])


def test_masks_of_some_stations_keep_the_shape_of_the_index() -> None:
    assert MASK.at(np.array([[2], [0]])).limited.tolist() == [[True], [False]]
    assert bool(MASK.at(1).limited)
    assert not ElevationMask.none(3).limited.any()


def test_a_problem_without_elevations_has_no_masks() -> None:
    plain = make_problem([0, 0, 100], [0, 0, 100], [[0, 0, 0, 600]])
    assert ElevationMask.of(plain) is None
    masked = make_problem(
        [0, 0, 100], [0, 0, 100], [[0, 0, 0, 600]], min_elevation_deg=ElevationMask.none(1).lowest_deg
    )
    mask = ElevationMask.of(masked)
    assert mask is not None
    assert not mask.limited.any()
    with pytest.raises(ProblemError, match="or -90 for no limit"):
        make_problem([0, 0, 100], [0, 0, 100], [[0, 0, 0, 600]], min_elevation_deg=np.array([-5.0]))
