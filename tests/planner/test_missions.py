"""The missions the other tests stand on are what they say."""

from __future__ import annotations

import numpy as np

from tests.support.missions.problems import PAPER_LIKE, paper_problem


def test_thirty_missions_as_in_the_papers_table_2() -> None:
    assert len(PAPER_LIKE) == 30
    for name in PAPER_LIKE:
        problem = paper_problem(name)
        assert problem.station_count == int(name[1:].split("_")[0])
        assert (problem.limits.min_alt_m, problem.limits.max_alt_m) == (100.0, 120.0)
        assert (problem.limits.max_speed_m_s, problem.limits.max_accel_m_s2) == (50.0, 5.0)
        assert ((problem.ranges_m >= 500.0) & (problem.ranges_m <= 1500.0)).all()
        assert (problem.station_positions_m[:, 2] == 0.0).all()
        assert len(problem.covers(problem.start_m))
        assert len(problem.covers(problem.destination_m))


def test_margin_comes_off_every_range() -> None:
    whole, less = paper_problem("M30_01"), paper_problem("M30_01", margin_m=25.0)
    np.testing.assert_allclose(whole.ranges_m - less.ranges_m, 25.0)
