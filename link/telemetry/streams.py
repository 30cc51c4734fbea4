"""What a flight is watched by, and how often the vehicle is asked to send it."""

from __future__ import annotations

from link.dialect import mavlink

STREAMED_MESSAGES: tuple[tuple[int, float], ...] = (
    (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 10.0),
    # Every 111 ms: no multiple of a usual interval of setpoints, so that of two senders who alternate each is seen. It
    # goes through theirs in steps of an eighth, shifted a little each time. ArduPilot keeps whole milliseconds.
    (mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED, 1000.0 / 111.0),
    (mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE, 2.0),
    # The battery, and the health of its sensors.
    (mavlink.MAVLINK_MSG_ID_SYS_STATUS, 1.0),
    (mavlink.MAVLINK_MSG_ID_GPS_RAW_INT, 2.0),
    # For those who look at the log afterwards: 0.2 kB/s, which a radio at 57600 baud carries beside the rest.
    (mavlink.MAVLINK_MSG_ID_ATTITUDE, 4.0),
)
"""What the station in control asks every vehicle to send, and how often, in Hz; see also `ESTIMATOR_HZ`."""
ESTIMATOR_HZ = 2.0
"""Of the estimator's own report (`link.autopilot.profile.AutopilotProfile.estimator_message_id`)."""
NEEDED = frozenset({mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT})
"""Those a flight does not go on without."""
