"""MAVLink's microservices: command, parameter, mission.

*Mission* is MAVLink's word here: a list of items stored in the vehicle, whether waypoints, a geofence or rally points.
Our own `gcs.mission.Mission`, what a flight is planned from, is another thing.
"""

from link.microservices.parameter_value import Parameter

__all__ = ["Parameter"]
