"""GCS ids by parameter: one station heard at a time, moved in flight, nobody locked out, given back at the end."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs.flight import FlightState
from link.dialect import mavlink
from link.director.core import FlightCore
from link.errors import GateClosed
from link.handover.gcs_ids import ENFORCE, GcsIdManager, GcsIds
from link.microservices.parameter_value import Parameter
from link.session.request import FlightRequest
from link.transport.gate import Sender, TransmitterGate
from tests.support.flights.on_ground import checks, on_ground
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.plans.planned import relay_plan

NAMES = ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS")
OLD_NAMES = ("SYSID_MYGCS", "SYSID_ENFORCE")
FIRMWARE = pytest.mark.parametrize("firmware", ["", "4.6"])
OWNERS = ("s1", "s2", "s3")


def by_parameter(firmware: str = "", stations: int = 3, **settings: Any) -> VirtualFlight:
    request = {"handover_way": "parameter", **settings.pop("request", {})}
    config = {"firmware": firmware, **settings.pop("config", {})}
    settings.setdefault("frugal", True)
    return VirtualFlight(relay_plan(stations), "ardupilot", request=request, config=config, **settings)


def heard(one: VirtualFlight) -> set[str]:
    """The stations the vehicle obeys now."""
    ids = one.core.context.control.system_ids
    return {s for s in one.stations if one.vehicle.autopilot.is_owner(ids[s])}


def given_back(one: VirtualFlight) -> bool:
    names = OLD_NAMES if one.vehicle.config.firmware else NAMES
    stock = {"MAV_GCS_SYSID": 255, "SYSID_MYGCS": 255}
    return all(one.vehicle.parameters[name] == stock.get(name, 0) for name in names)


def obeyed_from_its_holder(one: VirtualFlight) -> None:
    for accepted in one.accepted:
        assert accepted.holder_when_sent == accepted.station


# -- whole flights ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@FIRMWARE
@pytest.mark.parametrize("links", ["good", "bad"])
def test_a_flight_hears_one_station_at_a_time_and_is_given_back(firmware: str, links: str) -> None:
    bad = Proxy(loss=0.1, latency_s=0.05, jitter_s=0.1, duplicates=0.1, seed=4)
    one = by_parameter(firmware, 2 if links == "bad" else 3, proxy=bad if links == "bad" else None)
    owners: list[set[str]] = []
    while not one.core.finished and one.now_s < 400.0:
        one.step()
        if one.core.state is FlightState.CRUISE and (not owners or owners[-1] != heard(one)):
            owners.append(heard(one))
    assert one.core.state is FlightState.COMPLETED
    obeyed_from_its_holder(one)
    assert given_back(one)
    released = one.said("handover", state="released")
    assert [e.data["way"] for e in released] == ["parameter"] * len(one.plan.handovers)
    # Make before break: both are heard before control moves, one again after; without a range one after the other.
    steps = [{"s1"}, {"s2"}, {"s3"}] if firmware else [{"s1"}, {"s1", "s2"}, {"s2"}, {"s2", "s3"}, {"s3"}]
    assert owners == steps[: len(steps) if links == "good" else 2 if firmware else 3]
    # Nobody's setpoints are missed for longer than an answer takes (good: a tick or two; bad: 0.3 s and losses).
    for event in one.said("handover", state="requested"):
        gap_s = one.longest_gap_s(event.time_s - 2.0, event.time_s + 2.0)
        assert gap_s <= (0.16 if links == "good" else 1.2)
    if links == "good":
        assert not one.said("alarm")


def test_an_older_firmware_is_refused_another_way_with_the_only_one_it_has() -> None:
    one = on_ground("ardupilot", config={"firmware": "4.6"})
    assert one.core.state is FlightState.REFUSED
    told = checks(one)["ownership"]
    assert told["level"] == "failure"
    assert "--handover-way parameter" in told["fix"]
    # With one station there is nothing to hand over.
    alone = on_ground("ardupilot", relay_plan(1), config={"firmware": "4.6"})
    assert alone.core.state is FlightState.READY
    assert alone.vehicle.parameters["SYSID_MYGCS"] == alone.core.context.control.system_ids["s1"]


@pytest.mark.slow
@FIRMWARE
def test_an_abort_hands_back_over_the_same_windows_and_gives_back(firmware: str) -> None:
    one = by_parameter(firmware, 2)
    one.run(until=lambda: one.plan_s > 25.0, limit_s=300.0)
    assert heard(one) == {"s2"}
    one.core.command("abort", by="pilot")
    assert one.run(limit_s=300.0) is FlightState.CONTINGENCY
    assert one.said("handover", state="released", forward=False)
    obeyed_from_its_holder(one)
    assert given_back(one)


@FIRMWARE
def test_a_dead_links_neighbour_opens_the_vehicle_with_the_vehicles_own_id(firmware: str) -> None:
    one = by_parameter(firmware, 2)
    window = one.core.airborne.chain.windows[0]
    one.run(until=lambda: one.plan_s > window.open_s + 1.0, limit_s=300.0)
    assert one.core.airborne.chain.leg == 0
    one.proxy.cuts.append(("s1", one.now_s, 1e9))
    one.run(until=lambda: heard(one) == {"s2"}, limit_s=10.0)
    (alarm,) = one.said("alarm", what="ownership by the vehicle's own id")
    assert alarm.data["station"] == "s2"
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    obeyed_from_its_holder(one)
    assert given_back(one)


@pytest.mark.slow
@FIRMWARE
def test_answers_that_are_lost_leave_two_candidates_and_the_one_obeyed_owns(firmware: str) -> None:
    """No PARAM_VALUE comes back in flight: nobody is told what was taken, and still one is obeyed throughout."""
    one = by_parameter(firmware, 2, config={"faults": ("param-silent@T1+60",)})
    assert one.run(limit_s=500.0) in (FlightState.COMPLETED, FlightState.CONTINGENCY)
    obeyed_from_its_holder(one)
    assert not one.said("state", to="lapsed")
    assert given_back(one)
    if firmware:
        assert one.core.airborne.chain.leg == 1  # tried, and obeyed


@pytest.mark.slow
@FIRMWARE
def test_writes_that_are_not_taken_leave_the_old_station_in_control(firmware: str) -> None:
    name = "SYSID_MYGCS" if firmware else "MAV_GCS_SYSID_HI"
    one = by_parameter(firmware, 2, config={"faults": (f"param-set-ignored:{name}@T1",)})
    assert one.run(limit_s=500.0) is FlightState.CONTINGENCY
    assert one.core.airborne.chain.leg == 0
    assert one.said("handover", state="timed_out")
    obeyed_from_its_holder(one)


def test_a_lost_vehicle_is_not_written_to_any_more() -> None:
    one = by_parameter("", 2, config={"faults": ("disarm-in-flight@T5",)})
    assert one.run(limit_s=400.0) is FlightState.LOST
    lost_s = one.said("state", to="lost")[0].time_s
    assert not [t for t, _, _, m in one.sent_messages("PARAM_SET") if t > lost_s + 0.1]
    (alarm,) = one.said("alarm", what="the vehicle keeps what this flight changed")
    assert alarm.data["changed"] == ["ownership"]


def test_a_word_that_comes_late_finds_every_link_still_proved() -> None:
    """The vehicle hears one station from the preflight on; the others prove their links with the id it always hears."""
    one = by_parameter("", 2, request={"auto_launch": False})
    one.run_for(80.0)
    assert one.core.state is FlightState.READY
    one.core.command("launch", by="pilot")
    one.run(until=lambda: one.core.state.airborne, limit_s=60.0)
    assert one.states.count("preflight") == 2
    assert one.core.state.airborne


# -- the manager alone -------------------------------------------------------------------------------------------------


@cache
def _request() -> FlightRequest:
    plan = relay_plan()
    links = {s: f"udpout:127.0.0.1:{20000 + k}" for k, s in enumerate(plan.station_ids)}
    return FlightRequest(plan=plan.to_document(), autopilot="ardupilot", links=links)


class Bench:
    """A manager, and a vehicle reduced to its three values: hears whom it must, loses what is drawn."""

    def __init__(self, ranged: bool) -> None:
        core = FlightCore(_request())
        self.c = core.context
        self.c.control.grant("s1", "first")
        self.ids = self.c.control.system_ids
        names = {"gcs_system_id": "MAV_GCS_SYSID", "enforce_gcs": "MAV_OPTIONS"}
        names |= {"gcs_system_id_high": "MAV_GCS_SYSID_HI"} if ranged else {}
        self.truth = GcsIds(self.ids["s1"], self.ids["s1"] if ranged else None, ENFORCE)
        values = {key: Parameter(name, 0, 4) for key, name in names.items()}
        self.manager = GcsIdManager(self.c, values, self.truth)
        self.fields = {"MAV_GCS_SYSID": "low", "MAV_GCS_SYSID_HI": "high", "MAV_OPTIONS": "options"}

    def tick(self, reaches: bool, answered: bool) -> None:
        self.c.timeline.now_s += 0.05
        self.manager.step(self.c.timeline.now_s)
        for sender, frame in self.c.control.gate.take_outgoing():
            (message,) = mavlink.MAVLink(None).parse_buffer(bytearray(frame)) or []
            assert sender.station_id == self.c.control.gate.holder
            own = message.get_srcSystem() == self.c.vehicle.system_id
            if not reaches or not (own or self.truth.hears(message.get_srcSystem())):
                continue
            field = self.fields[message.param_id]
            self.truth = GcsIds(
                **{**self.truth.__dict__, field: int(message.param_value)}  # type: ignore[arg-type]
            )
            if answered:
                self.manager.on_value(message.param_id, message.param_value)


@settings(max_examples=60, deadline=None)
@given(
    st.booleans(),
    st.lists(
        st.tuples(st.sampled_from(OWNERS), st.sampled_from([None, *OWNERS]), st.integers(1, 12), st.integers(0, 3)),
        min_size=1,
        max_size=8,
    ),
)
def test_whatever_is_lost_the_truth_is_among_the_candidates_and_the_holder_ends_heard(
    ranged: bool, moves: list[tuple[str, str | None, int, int]]
) -> None:
    """``moves``: who is in control, who accompanies, for how many ticks, and what is lost (1 the way there, 2 back)."""
    bench = Bench(ranged)
    for holder, partner, ticks, losses in moves:
        bench.c.control.grant(holder, "drawn")
        bench.c.control.gate.accompany(None if partner == holder else partner)
        for _ in range(ticks):
            bench.tick(reaches=not losses & 1, answered=not losses & 2)
            assert bench.truth in bench.manager.states
            for station in OWNERS:
                if bench.manager.hears(station):
                    assert bench.truth.hears(bench.ids[station]), "believed heard, and is not"
    bench.c.control.gate.accompany(None)
    for _ in range(40):
        bench.tick(reaches=True, answered=True)
    holder = str(bench.c.control.gate.holder)
    assert bench.manager.hears(holder)
    assert {s for s in OWNERS if bench.truth.hears(bench.ids[s])} == {holder}
    bench.c.control.gate.take_outgoing()
    bench.tick(reaches=True, answered=True)  # and then it is quiet
    assert bench.c.control.gate.take_outgoing() == []


def test_the_vehicles_own_id_is_no_door_for_a_station_that_is_not_in_control() -> None:
    gate = TransmitterGate({s: lambda m: b"" for s in ("s1", "s2")}, {s: lambda m: b"" for s in ("s1", "s2")})
    grant = gate.grant("s1")
    message = mavlink.MAVLink_param_set_message(1, 1, b"MAV_GCS_SYSID", 242.0, 4)
    gate.send(grant, message, sender=Sender("s1", as_vehicle=True))
    with pytest.raises(GateClosed, match="s1 is in control"):
        gate.send(grant, message, sender=Sender("s2", as_vehicle=True))
    gate.grant("s2")
    with pytest.raises(GateClosed):
        gate.send(grant, message, sender=Sender("s1", as_vehicle=True))
    assert gate.stats.blocked == 2
