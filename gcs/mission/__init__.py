"""What is to be flown: the mission, its document, system ids, hours."""

from gcs.mission.document import parse_mission_json, parse_option, read_mission, station_faults, with_options
from gcs.mission.model import Mission, MissionOptions
from gcs.mission.writing import write_mission

__all__ = [
    "Mission",
    "MissionOptions",
    "parse_mission_json",
    "parse_option",
    "read_mission",
    "station_faults",
    "with_options",
    "write_mission",
]
