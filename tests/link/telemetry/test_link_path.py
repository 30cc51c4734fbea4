"""A station's ways to the vehicle: what is measured of each, and which of them sends."""

from __future__ import annotations

import random

import pytest

from gcs.flight import FlightState
from link.telemetry.link_path import LinkPath
from link.telemetry.station_link import StationLink
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def test_loss_is_told_by_the_frames_numbers_whatever_comes_late_or_twice() -> None:
    chance, path = random.Random(5), LinkPath()
    numbers = [(k % 256) for k in range(900)]
    kept = [n for n in numbers if chance.random() > 0.2]
    for k in range(0, len(kept) - 1, 7):
        kept[k], kept[k + 1] = kept[k + 1], kept[k]
    for k, number in enumerate(kept):
        path.heard(0.1 * k, number)
        if k % 5 == 0:
            path.heard(0.1 * k, number)
    assert path.loss == pytest.approx(1.0 - len(kept) / len(numbers), abs=0.01)


def test_a_perfect_link_loses_nothing_and_nothing_heard_tells_nothing() -> None:
    path = LinkPath()
    assert (path.loss, path.round_loss(9.0), path.latency_s, path.quality(9.0)) == (None, None, None, None)
    for number in [*range(200, 256), *range(256), *range(20)]:
        path.heard(1.0, number)
    assert path.loss == 0.0


def test_round_trips_give_latency_jitter_and_loss() -> None:
    path = LinkPath()
    for k in range(40):
        path.probed(float(k), k)
        if k % 4:
            assert path.answered(k, k + (0.3 if k % 2 else 0.2))
            assert not path.answered(k, k + 0.5)  # a second copy
    assert not path.answered(999, 40.0)
    assert path.round_loss(45.0) == 0.25
    assert path.latency_s == pytest.approx(0.13, abs=0.02)
    assert path.least_latency_s == pytest.approx(0.1)
    # 0.3 0.2 0.3 | 0.3 0.2 0.3: two changes of 0.1 in three.
    assert path.jitter_s == pytest.approx(0.067, abs=0.02)
    assert path.proven_s == 39.0


def test_another_way_sends_once_its_proof_is_newer_by_the_patience() -> None:
    link = StationLink("a", ("one", "two"))
    first, second = link.paths
    first.proven_s, second.proven_s = 10.0, 10.3
    assert link.choose(0.4) == ""
    second.proven_s = 10.5
    assert link.choose(0.4) == "one"
    assert (link.active, link.proven_s) == (second, 10.5)
    assert link.choose(0.4) == ""


@pytest.mark.slow
@BOTH
def test_a_dead_way_of_a_station_is_left_for_its_other_one_before_anything_is_missed(autopilot: str) -> None:
    """The way that sends dies in cruise: within half a second the other sends, the station stays in control."""
    one = VirtualFlight(relay_plan(2), autopilot, frugal=True, ways=2)
    one.run(until=lambda: one.plan_s >= 8.0, limit_s=100.0)
    cut_s = one.now_s
    one.proxy.cuts.append(("s1", cut_s, 1e9))
    assert one.run(limit_s=300.0) is FlightState.COMPLETED
    (switch,) = one.said("link", station="s1")
    assert 0.0 < switch.time_s - cut_s <= 0.6
    assert one.longest_gap_s(cut_s - 1.0, cut_s + 5.0) <= 0.65
    # No handover for it: control moved once, where it was planned.
    assert [e.data["to"] for e in one.said("handover", state="released")] == ["s2"]
    assert not one.said("alarm")
    ids = {s.id: s.system_id for s in one.plan.mission.stations}
    for accepted in one.accepted:
        assert accepted.station == accepted.holder_when_sent
        assert accepted.system_id == ids[accepted.station]
    # One transmitter: no setpoint came twice.
    times = [a.sent_s for a in one.accepted]
    assert len(times) == len(set(times))


def test_links_are_told_with_loss_latency_and_jitter() -> None:
    proxy = Proxy(seed=4, loss=0.1, latency_s=0.05, jitter_s=0.02, later_s={"s1/2": 0.2})
    one = VirtualFlight(relay_plan(2), "px4", proxy=proxy, ways=2)
    one.run(until=lambda: one.plan_s >= 6.0, limit_s=100.0)
    first, second = one.core.status()["links"]["s1"]["ways"]
    assert first["latency_ms"] == pytest.approx(60.0, abs=15.0)
    assert second["latency_ms"] == pytest.approx(260.0, abs=30.0)
    for way in (first, second):
        assert 0.05 < way["loss"] < 0.15
        assert 0.08 < way["round_loss"] < 0.35
        assert 2.0 < way["jitter_ms"] < 30.0
    assert one.core.summary()["links"]["s1"]["ways"][0]["url"] == first["url"]


def test_over_tcp_a_frame_may_come_in_pieces() -> None:
    from link.dialect import mavlink
    from link.director.core import FlightCore
    from link.session.request import FlightRequest
    from link.wire.codec import StationCodec

    plan = relay_plan(2)
    urls = {"s1": ["udpout:127.0.0.1:9", "tcp:127.0.0.1:9"], "s2": "tcp:127.0.0.1:10"}
    core = FlightCore(FlightRequest(plan=plan.to_document(), autopilot="px4", links=urls))
    vehicle = StationCodec(1, 1)
    frame = vehicle.encode(mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3))
    core.receive("s1", frame[:9], 1.0, "tcp:127.0.0.1:9")
    core.receive("s1", frame[9:], 1.1, "tcp:127.0.0.1:9")
    first, second = core.context.vehicle.monitor.links["s1"].paths
    assert (first.messages, second.messages) == (0, 1)
    # So it is where a bridge cuts it at the border of two datagrams.
    core.receive("s1", frame[:9], 2.0, "udpout:127.0.0.1:9")
    core.receive("s1", frame[9:], 2.1, "udpout:127.0.0.1:9")
    assert first.messages == 1
