"""How a flight went, in figures."""

from __future__ import annotations

from typing import Any

from link.clock import TickLateness
from link.director.airborne import Airborne
from link.session.context import FlightContext


def summary(
    flight: FlightContext, air: Airborne, lateness: TickLateness, *, late_s: float | None = None
) -> dict[str, Any]:
    """The figures of its end. ``handovers`` are those confirmed, there and back; ``handovers_back`` those back.

    ``late_s``: how much later than planned it arrived; None where it did not.
    """
    timeline = flight.timeline
    links = flight.vehicle.monitor.links.values()
    return {
        "outcome": timeline.state.value,
        "exit_code": timeline.state.exit_code if timeline.state.ended else None,
        "plan_sha256": flight.plan.plan_sha256,
        "flown_s": None if timeline.t_plus_s is None else round(timeline.t_plus_s, 3),
        "late_s": None if late_s is None else round(late_s, 3),
        "setpoints": flight.control.setpoints_sent,
        "handovers": air.chain.done_forward + air.chain.done_back,
        "handovers_back": air.chain.done_back,
        "tracking_rms_m": round(air.lag.rms_m, 3),
        "tracking_worst_m": round(air.lag.worst_m, 3),
        "lateness": lateness.to_document(),
        "links": {link.station_id: link.to_document(timeline.now_s) for link in links},
    }
