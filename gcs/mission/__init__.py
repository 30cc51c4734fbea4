"""What is to be flown: the mission, its document, system ids, hours."""

from gcs.mission.document import parse_mission_json, parse_option
from gcs.mission.model import Mission, MissionOptions

__all__ = ["Mission", "MissionOptions", "parse_mission_json", "parse_option"]
