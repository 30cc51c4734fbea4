"""``--link`` on the command line: one or several URLs a station, one for all, stations in reserve."""

from __future__ import annotations

import pytest

from api.cli.commands.fly import links_of, request_of
from api.cli.errors import BadInputError
from tests.support.plans.planned import wide_plan

ONE, TWO, ALL = "udpout:127.0.0.1:14541", "serial:/dev/ttyUSB0:57600", "udpin:127.0.0.1:14550"


def test_a_station_may_have_several_and_the_rest_share_one() -> None:
    plan = wide_plan()
    links = links_of(plan, [f"s2={ONE}", ALL, f"s2={TWO}", f"beside={ONE}"])
    # `beside` is in reserve: it has an id in the mission, and a link of its own.
    assert links == {"s1": [ALL], "s2": [ONE, TWO], "s3": [ALL], "s4": [ALL], "beside": [ONE]}
    request = request_of(plan, links=links, autopilot="px4")
    assert request.urls["s2"] == (ONE, TWO)
    assert request.stations == ("s1", "s2", "s3", "s4", "beside")
    again = type(request).from_document(request.to_document())
    assert again.urls == request.urls
    assert request.to_document()["links"]["s1"] == ALL


def test_a_link_that_is_none_is_refused_wherever_it_stands() -> None:
    with pytest.raises(BadInputError):
        links_of(wide_plan(), [ALL, "s2=udp:1"])
    with pytest.raises(BadInputError):
        request_of(wide_plan(), links={s: [ALL] for s in ("s1", "s2", "s3")}, autopilot="px4")
