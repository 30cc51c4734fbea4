"""What shows, as a mission is laid out, that nobody can fly it."""

from __future__ import annotations

from gcs.errors import Finding
from gcs.mission.model import Mission


class NoRangeLeft(Finding):
    """The range margin leaves no station any range."""

    def __init__(self, mission: Mission) -> None:
        super().__init__(f"a range margin of {mission.options.range_margin_m:g} m leaves no station any range")
        self.mission = mission


class NoAirspeed(Finding):
    """The wind carries the vehicle away: ``standing_m_s`` is the airspeed it takes to hold a place."""

    def __init__(self, mission: Mission, standing_m_s: float) -> None:
        super().__init__(f"it takes an airspeed of {standing_m_s:.1f} m/s to hold a place in the wind")
        self.mission = mission
        self.standing_m_s = standing_m_s
