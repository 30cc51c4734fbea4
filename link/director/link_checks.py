"""The preflight's look at every station's C2 link."""

from __future__ import annotations

from collections.abc import Callable

from link.handover.handover_chain import attempt_time_s
from link.preflight.check import Check
from link.preflight.link import judge_link
from link.session.context import FlightContext
from link.session.procedure import Steps, wait_until
from link.transport.url import is_local

LINKS_WAIT_S = 8.0
"""How long the other stations' links are waited for once the vehicle is heard."""
QUALITY_WAIT_S = 4.0


def judge_links(
    flight: FlightContext, works: Callable[[str], bool], loss_timeout_s: float, *, simulated: bool
) -> Steps[list[Check]]:
    """Every station's link: heard and answered. A real vehicle on the ground is out of most stations' range.

    ``works`` says it of a station; ``loss_timeout_s`` is how long the autopilot goes without setpoints.
    """
    timeline, vehicle = flight.timeline, flight.vehicle
    first = flight.plan.station_ids[0]
    yield from wait_until(timeline, lambda: all(works(s) for s in vehicle.monitor.links), LINKS_WAIT_S)
    # A figure for the quality needs a few probes that are over.
    yield from wait_until(
        timeline,
        lambda: all(link.quality(timeline.now_s) is not None for link in vehicle.monitor.links.values()),
        QUALITY_WAIT_S,
    )
    attempt_s = attempt_time_s(flight.request, loss_timeout_s)
    checks: list[Check] = []
    for station in dict.fromkeys(flight.plan.station_ids):
        link, urls = vehicle.monitor.links[station], flight.request.urls[station]
        checks += judge_link(
            station,
            ", ".join(urls),
            works=works(station),
            same_origin=link.origin is None or vehicle.origin is None or link.origin == vehicle.origin,
            required=station == first or simulated,
            quality=link.quality(timeline.now_s),
            attempt_s=attempt_s,
            signed=flight.request.signing_key is not None,
            loopback=not flight.request.allow_unsigned or all(is_local(url) for url in urls),
        )
    return checks
