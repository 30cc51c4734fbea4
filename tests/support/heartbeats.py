"""Which HEARTBEAT is the flight controller's own: for listeners that hear everybody on a link."""

from __future__ import annotations

from typing import Any

from link.autopilot.profile import AUTOPILOT_COMPONENT, AutopilotProfile
from link.dialect import mavlink


def is_autopilot(profile: AutopilotProfile, message: Any) -> bool:
    """Whether ``message`` is a HEARTBEAT of this autopilot: gimbals and modems of the vehicle send them too."""
    return bool(
        message.get_type() == "HEARTBEAT"
        and message.get_srcComponent() == AUTOPILOT_COMPONENT
        and message.autopilot == profile.autopilot_id
        and message.type != mavlink.MAV_TYPE_GCS
    )
