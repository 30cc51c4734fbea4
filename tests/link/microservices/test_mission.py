"""Mission, rally and fence transfer over bad links: exact, or a clean failure that says what the vehicle may hold."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.errors import MissionItemError
from link.microservices.mission_download import MissionDownload, MissionTransfer, Timing, TransferState
from link.microservices.mission_item import (
    AMSL,
    FENCE,
    RALLY,
    RELATIVE,
    MissionItem,
    inclusion_fence,
    rally_point,
)
from link.microservices.mission_upload import MissionClear, MissionUpload
from link.wire.codec import StationCodec
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.scorecard.soak import counted
from tests.support.link.mission_vehicle import BadLink, MissionVehicle

KINDS = ("px4", "ardupilot")
ADDRESS: dict[str, Any] = {"target": (1, 1), "station": (241, 190)}


def waypoint(lat_deg: float, lon_deg: float, alt_m: float, *, frame: int, hold_s: float = 0.0) -> MissionItem:
    """A place to fly to; the heading is left to the vehicle."""
    command = mavlink.MAV_CMD_NAV_WAYPOINT
    return MissionItem(command, lat_deg, lon_deg, alt_m, frame, (hold_s, 0.0, 0.0, math.nan))


def route(count: int, alt_m: float = 100.0) -> list[MissionItem]:
    return [waypoint(53.0 + 1e-3 * i, 4.8 - 2e-3 * i, alt_m + i, frame=RELATIVE, hold_s=float(i)) for i in range(count)]


def as_held(items: list[MissionItem]) -> list[Any]:
    return [item.message(i, 0, 1, 1) for i, item in enumerate(items)]


def vehicle(kind: str, count: int = 20) -> MissionVehicle:
    return MissionVehicle(kind, as_held(route(count, 500.0)))


def upload(kind: str, items: list[MissionItem], **options: Any) -> MissionUpload:
    return MissionUpload(items, traits=PROFILES[kind].mission, **{**ADDRESS, **options})


def clear(kind: str, **options: Any) -> MissionClear:
    return MissionClear(traits=PROFILES[kind].mission, **{**ADDRESS, **options})


def holds(vehicle: MissionVehicle, items: list[MissionItem]) -> bool:
    """Field by field, as the vehicle would fly it."""
    got = [MissionItem.from_message(message) for message in vehicle.held]
    return len(got) == len(items) and all(
        (a.command, a.frame, a.alt_m) == (b.command, b.frame, b.alt_m)
        and abs(a.lat_deg - b.lat_deg) < 1.1e-7
        and abs(a.lon_deg - b.lon_deg) < 1.1e-7
        and a.parameters[:3] == b.parameters[:3]
        for a, b in zip(got, items, strict=True)
    )


def kinds_of(messages: list[Any]) -> list[str]:
    return [
        f"{m.get_type()[8:]} {getattr(m, 'seq', getattr(m, 'count', getattr(m, 'type', '')))}".strip() for m in messages
    ]


def said(kind: Any, *fields: Any, mission_type: int = 0, source: tuple[int, int] = (1, 1), to: int = 241) -> Any:
    """A message of the vehicle, through the wire."""
    message = kind(to, 190, *fields, mission_type=mission_type)
    (got,) = StationCodec(241 if source[0] != 241 else 1).decode(StationCodec(*source).encode(message))
    return got


# ---------------------------------------------------------------- the exchange, message by message


def test_an_upload_message_by_message() -> None:
    """COUNT, items as asked, ACK; a pause; then the list read back and acknowledged."""
    transfer = upload("px4", route(2))
    transfer.start(0.0)
    assert kinds_of(transfer.take_outgoing()) == ["COUNT 2"]
    for sequence in (0, 1):
        transfer.receive(said(mavlink.MAVLink_mission_request_int_message, sequence), 0.1)
        (item,) = transfer.take_outgoing()
        assert item.get_type() == "MISSION_ITEM_INT"
        assert (item.seq, item.target_system, item.x, item.y) == (
            sequence,
            1,
            530_000_000 + 10_000 * sequence,
            48_000_000 - 20_000 * sequence,
        )
    transfer.receive(said(mavlink.MAVLink_mission_ack_message, 0), 0.2)
    assert transfer.take_outgoing() == []
    assert transfer.running
    assert transfer.deadline_s == pytest.approx(1.2)
    transfer.step(1.19)
    assert transfer.take_outgoing() == []
    transfer.step(1.2)
    assert kinds_of(transfer.take_outgoing()) == ["REQUEST_LIST"]
    transfer.receive(said(mavlink.MAVLink_mission_count_message, 2), 1.3)
    for sequence, held in enumerate(as_held(route(2))):
        assert kinds_of(transfer.take_outgoing()) == [f"REQUEST_INT {sequence}"]
        fields = [getattr(held, n) for n in held.get_fieldnames() if n not in ("target_system", "target_component")]
        transfer.receive(said(mavlink.MAVLink_mission_item_int_message, *fields[:-1]), 1.4)
    assert kinds_of(transfer.take_outgoing()) == ["ACK 0"]
    assert transfer.state is TransferState.DONE
    assert transfer.progress == 1.0


def test_the_old_request_is_answered_with_the_new_item() -> None:
    """ArduPilot asks with MISSION_REQUEST and takes MISSION_ITEM_INT."""
    transfer = upload("ardupilot", route(3))
    transfer.start(0.0)
    transfer.take_outgoing()
    transfer.receive(said(mavlink.MAVLink_mission_request_message, 0), 0.1)
    assert [m.get_type() for m in transfer.take_outgoing()] == ["MISSION_ITEM_INT"]


def test_unasked_it_repeats_the_last_item_and_sends_the_next() -> None:
    transfer = upload("px4", route(3))
    transfer.start(0.0)
    transfer.step(1.49)
    assert kinds_of(transfer.take_outgoing()) == ["COUNT 3"]
    transfer.step(1.5)
    assert kinds_of(transfer.take_outgoing()) == ["COUNT 3"]
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 0), 2.0)
    transfer.take_outgoing()
    transfer.step(2.24)
    assert transfer.take_outgoing() == []
    transfer.step(2.25)
    assert kinds_of(transfer.take_outgoing()) == ["ITEM_INT 0", "ITEM_INT 1"]
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 2), 2.3)
    transfer.take_outgoing()
    transfer.step(2.6)
    assert kinds_of(transfer.take_outgoing()) == ["ITEM_INT 2"]


@pytest.mark.parametrize(
    "stranger",
    [
        {"source": (2, 1)},  # another vehicle
        {"source": (1, 154)},  # another component
        {"to": 242},  # meant for another station
        {"mission_type": RALLY},  # another list
    ],
)
def test_what_is_not_for_this_transfer_is_ignored(stranger: dict[str, Any]) -> None:
    transfer = upload("px4", route(3))
    transfer.start(0.0)
    transfer.take_outgoing()
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 0, **stranger), 0.1)
    transfer.receive(said(mavlink.MAVLink_mission_ack_message, 4, **stranger), 0.1)
    transfer.receive(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3), 0.1)
    assert transfer.take_outgoing() == []
    assert transfer.running


def test_a_request_beyond_the_list_is_not_answered() -> None:
    transfer = upload("px4", route(3))
    transfer.start(0.0)
    transfer.take_outgoing()
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 3), 0.1)
    assert transfer.take_outgoing() == []


# ---------------------------------------------------------------- over a good link


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [0, 1, 2, 200])
def test_upload_over_a_good_link(kind: str, count: int) -> None:
    there = vehicle(kind)
    transfer = upload(kind, route(count))
    BadLink(there).run(transfer)
    assert transfer.state is TransferState.DONE, transfer.failure
    if count or kind == "px4":
        assert holds(there, route(count))
    else:
        assert len(there.held) <= 1  # home alone


@pytest.mark.parametrize("kind", KINDS)
def test_download_over_a_good_link(kind: str) -> None:
    transfer = MissionDownload(**ADDRESS)
    took_s = BadLink(vehicle(kind, 150)).run(transfer)
    assert transfer.state is TransferState.DONE
    assert [item.alt_m for item in transfer.items] == [500.0 + i for i in range(150)]
    assert transfer.progress == 1.0
    assert took_s < 5.0


@pytest.mark.parametrize("kind", KINDS)
def test_clear_over_a_good_link(kind: str) -> None:
    there = vehicle(kind)
    transfer = clear(kind)
    BadLink(there).run(transfer)
    assert transfer.state is TransferState.DONE
    assert there.held == []


def test_rally_points_and_fences_have_their_own_lists() -> None:
    for mission_type, items in (
        (RALLY, [rally_point(53.1, 4.9, 40.0), rally_point(53.2, 5.0, 60.0)]),
        (FENCE, inclusion_fence([(53.0, 4.7), (53.3, 4.7), (53.3, 5.1)])),
    ):
        there = MissionVehicle("px4", [], mission_type)
        transfer = upload("px4", items, mission_type=mission_type)
        BadLink(there).run(transfer)
        assert transfer.state is TransferState.DONE
        assert {m.mission_type for m in there.held} == {mission_type}
        assert [m.command for m in there.held] == [i.command for i in items]


# ---------------------------------------------------------------- over bad links

BAD: dict[str, Any] = {"loss": 0.3, "doubled": 0.1, "delay_s": (0.0, 0.5)}


def check_outcome(kind: str, transfer: MissionTransfer, there: MissionVehicle, wanted: list[MissionItem]) -> bool:
    """Exact, or a failure that says so and does not claim more than is true."""
    if transfer.state is TransferState.DONE:
        assert holds(there, wanted)
        return True
    assert transfer.failure is not None
    assert transfer.failure.message
    if transfer.failure.vehicle_holds == "unchanged":
        assert holds(there, route(20, 500.0))
    return False


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(8))
def test_two_hundred_items_over_a_bad_link(kind: str, seed: int) -> None:
    """30 % loss each way, acks too, one in ten doubled, up to half a second late and so out of order."""
    there = vehicle(kind)
    transfer = upload(kind, route(200))
    BadLink(there, seed=seed, **BAD).run(transfer)
    assert check_outcome(kind, transfer, there, route(200))


@pytest.mark.soak
@pytest.mark.timeout(0)
@pytest.mark.parametrize("kind", KINDS)
def test_a_thousand_bad_links(kind: str) -> None:
    """Scorecard 13."""
    exact = []
    for seed in counted(f"{kind}: uploads of 200 items", range(1000)):
        there = vehicle(kind)
        transfer = upload(kind, route(200))
        BadLink(there, seed=seed, **BAD).run(transfer)
        exact.append(check_outcome(kind, transfer, there, route(200)))
    print(f"{kind}: {sum(exact)} of {len(exact)} exact, the others failed and said so")
    assert sum(exact) >= 0.99 * len(exact)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", [0.6, 0.8, 0.95])
def test_a_hopeless_link_ends_in_a_clean_failure(kind: str, loss: float) -> None:
    for seed in range(6):
        there = vehicle(kind)
        transfer = upload(kind, route(30))
        BadLink(there, seed=seed, loss=loss, doubled=0.2, delay_s=(0.0, 0.5)).run(transfer, limit_s=1000.0)
        check_outcome(kind, transfer, there, route(30))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(3))
def test_download_and_clear_over_a_bad_link(kind: str, seed: int) -> None:
    there = vehicle(kind, 60)
    download = MissionDownload(**ADDRESS)
    BadLink(there, seed=seed, **BAD).run(download)
    assert download.state is TransferState.DONE
    assert [item.alt_m for item in download.items] == [500.0 + i for i in range(60)]
    emptying = clear(kind)
    BadLink(there, seed=seed, **BAD).run(emptying)
    assert emptying.state is TransferState.DONE
    assert there.held == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_lost_final_ack_is_not_a_failed_upload(kind: str) -> None:
    """The vehicle has finished and answers the repeated item with an error; the list itself tells."""
    there = vehicle(kind)
    link = BadLink(there)
    link.drop_to_station = ["MISSION_ACK"]
    transfer = upload(kind, route(5))
    link.run(transfer)
    assert transfer.state is TransferState.DONE
    assert holds(there, route(5))


def test_an_old_ack_does_not_finish_an_upload() -> None:
    """Accepted, says a late copy of an earlier answer, when only the first of three items was asked for."""
    transfer = upload("px4", route(3))
    transfer.start(0.0)
    transfer.receive(said(mavlink.MAVLink_mission_ack_message, 0), 0.05)
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 0), 0.1)
    transfer.receive(said(mavlink.MAVLink_mission_ack_message, 0), 0.15)
    transfer.take_outgoing()
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 1), 0.2)
    assert kinds_of(transfer.take_outgoing()) == ["ITEM_INT 1"]


def test_an_ack_before_the_last_item_arrived_does_not_end_the_answers() -> None:
    """After the acknowledgement the vehicle asks for the last item once more: it is not finished after all."""
    transfer = upload("px4", route(2))
    transfer.start(0.0)
    for sequence in (0, 1):
        transfer.receive(said(mavlink.MAVLink_mission_request_int_message, sequence), 0.1)
    transfer.receive(said(mavlink.MAVLink_mission_ack_message, 0), 0.2)
    transfer.take_outgoing()
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 1), 0.4)
    assert kinds_of(transfer.take_outgoing()) == ["ITEM_INT 1"]


# ---------------------------------------------------------------- failures


@pytest.mark.parametrize("kind", KINDS)
def test_a_silent_vehicle(kind: str) -> None:
    there = vehicle(kind)
    there.receive = lambda message, now_s: None  # type: ignore[method-assign]
    for transfer, words in (
        (upload(kind, route(3)), r"does not ask for the first item \(4 attempts\)"),
        (MissionDownload(**ADDRESS), "did not answer 6 requests"),
        (clear(kind), "reading back: mission: the vehicle did not answer"),
    ):
        BadLink(there).run(transfer)
        assert transfer.failure is not None
        assert transfer.failure.reason == "silent"
        assert re.search(words, transfer.failure.message)


@pytest.mark.parametrize("kind", KINDS)
def test_a_command_the_vehicle_does_not_support(kind: str) -> None:
    """PX4 keeps its old list; ArduPilot has already overwritten the beginning of it."""
    there = vehicle(kind)
    items = route(5)
    items[2] = MissionItem(12345)
    transfer = upload(kind, items)
    took_s = BadLink(there).run(transfer)
    assert transfer.failure is not None
    assert transfer.failure.reason == "refused"
    assert transfer.failure.message == "mission refused: a command it does not support in item 2"
    assert transfer.failure.vehicle_holds == ("unchanged" if kind == "px4" else "unknown")
    assert holds(there, route(20, 500.0)) == (kind == "px4")
    assert took_s < 1.0  # no use in trying again


@pytest.mark.parametrize("kind", KINDS)
def test_a_list_that_is_too_long(kind: str) -> None:
    there = vehicle(kind)
    transfer = upload(kind, route(700))
    BadLink(there).run(transfer)
    assert transfer.failure is not None
    assert transfer.failure.message == "mission refused: more items than it has room for"
    assert transfer.failure.vehicle_holds == "unchanged"
    assert holds(there, route(20, 500.0))


def test_a_vehicle_busy_with_another_station_is_waited_for() -> None:
    """ArduPilot denies until the other transfer gave up after 8 s."""
    there = vehicle("ardupilot")
    other = StationCodec(242)
    (count,) = StationCodec(1, 1).decode(other.encode(mavlink.MAVLink_mission_count_message(1, 1, 3)))
    there.receive(count, 100.0)
    transfer = upload("ardupilot", route(5))
    took_s = BadLink(there).run(transfer)
    assert transfer.state is TransferState.DONE
    assert 8.0 < took_s < 14.0
    assert holds(there, route(5))


def test_a_vehicle_that_stays_busy() -> None:
    transfer = upload("ardupilot", route(5))
    now_s = 0.0
    transfer.start(now_s)
    while True:
        transfer.receive(said(mavlink.MAVLink_mission_ack_message, mavlink.MAV_MISSION_DENIED), now_s)
        if not transfer.running:
            break
        now_s = transfer.deadline_s
        transfer.step(now_s)
    assert now_s == pytest.approx(9.0)  # three pauses
    assert transfer.failure is not None
    assert transfer.failure.reason == "busy"
    assert transfer.failure.vehicle_holds == "unchanged"


@pytest.mark.parametrize("kind", KINDS)
def test_a_vehicle_that_stores_something_else_is_found_out(kind: str) -> None:
    """Acknowledged, but item 3 came back 50 m lower: only reading back can tell."""
    there = vehicle(kind)
    original = there.on_mission_request_int

    def lying(message: Any, station: int, now_s: float) -> None:
        if message.seq == 3:
            there.held[3].z = 53.0
        original(message, station, now_s)

    there.on_mission_request_int = lying  # type: ignore[method-assign]
    transfer = upload(kind, route(6))
    BadLink(there).run(transfer)
    assert transfer.failure is not None
    assert transfer.failure.reason == "different"
    assert "item 3 is" in transfer.failure.message
    assert transfer.failure.vehicle_holds == "unknown"


def test_a_vehicle_that_counts_differently_is_found_out() -> None:
    there = vehicle("px4")
    there.on_mission_request_list = lambda message, station, now_s: there.send(  # type: ignore[method-assign]
        station, mavlink.MAVLink_mission_count_message, len(there.held) + 1
    )
    transfer = upload("px4", route(6))
    BadLink(there).run(transfer)
    assert transfer.failure is not None
    # The one item too many never comes.
    assert transfer.failure.reason == "silent"
    assert "item 6" in transfer.failure.message


def test_a_vehicle_that_holds_nonsense_is_found_out() -> None:
    """PX4 stores latitude 95."""
    there = vehicle("px4")
    original = there.on_mission_request_int

    def spoiled(message: Any, station: int, now_s: float) -> None:
        there.held[1].x = 950_000_000
        original(message, station, now_s)

    there.on_mission_request_int = spoiled  # type: ignore[method-assign]
    transfer = upload("px4", route(3))
    BadLink(there).run(transfer)
    assert transfer.failure is not None
    assert transfer.failure.reason == "different"
    assert "lat_deg is 95" in transfer.failure.message


@pytest.mark.parametrize("kind", KINDS)
def test_the_link_dies_in_the_middle(kind: str) -> None:
    """At the worst moment: what the vehicle holds is not claimed to be known where it is not."""
    for dies_after in range(1, 24):
        there = vehicle(kind)
        link = BadLink(there)
        throw, thrown = link.throw, [0]

        def cut(frame: bytes, *, up: bool, throw: Any = throw, thrown: Any = thrown, limit: int = dies_after) -> None:
            thrown[0] += 1
            if thrown[0] <= limit:
                throw(frame, up=up)

        link.throw = cut  # type: ignore[method-assign]
        transfer = upload(kind, route(8))
        link.run(transfer)
        assert transfer.state is TransferState.FAILED
        check_outcome(kind, transfer, there, route(8))


def test_cancelling_tells_the_vehicle() -> None:
    there = vehicle("px4")
    transfer = upload("px4", route(5))
    transfer.start(0.0)
    transfer.take_outgoing()
    transfer.cancel()
    (ack,) = transfer.take_outgoing()
    assert (ack.get_type(), ack.type) == ("MISSION_ACK", mavlink.MAV_MISSION_OPERATION_CANCELLED)
    assert transfer.failure is not None
    assert transfer.failure.reason == "cancelled"
    transfer.cancel()
    transfer.receive(said(mavlink.MAVLink_mission_request_int_message, 0), 1.0)
    transfer.step(100.0)
    assert transfer.take_outgoing() == []
    assert holds(there, route(20, 500.0))


def test_a_shorter_patience() -> None:
    there = vehicle("px4")
    there.receive = lambda message, now_s: None  # type: ignore[method-assign]
    transfer = upload("px4", route(3), timing=Timing(start_s=0.5, start_tries=2, attempts=1))
    assert BadLink(there).run(transfer) == pytest.approx(1.0)


# ---------------------------------------------------------------- items


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lat_deg": 95.0}, "lat_deg is 95.0, allowed is -90 to 90"),
        ({"lat_deg": math.nan}, "lat_deg is nan"),
        ({"lon_deg": 180.1}, "lon_deg is 180.1, allowed is -180 to 180"),
        ({"alt_m": 30_000.0}, "alt_m is 30000.0"),
        ({"alt_m": math.inf}, "alt_m is inf"),
        ({"frame": 1}, "frame is 1, allowed are 0, 3, 10, 2"),
        ({"command": 70_000}, "command is 70000"),
        ({"parameters": (math.inf, 0.0, 0.0, 0.0)}, "parameters are"),
    ],
)
def test_items_no_vehicle_may_be_sent(change: dict[str, Any], words: str) -> None:
    with pytest.raises(MissionItemError, match=words):
        MissionItem(**{"command": 16, **change})


def test_items_there_and_back_in_either_name_of_a_frame() -> None:
    item = waypoint(-53.1234567, 179.9999999, 33.25, frame=mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT, hold_s=2.0)
    assert item.frame == RELATIVE
    (message,) = StationCodec(1, 1).decode(StationCodec(241).encode(item.message(7, 0, 1, 1)))
    assert (message.seq, message.x, message.y, message.z) == (7, -531_234_567, 1_799_999_999, 33.25)
    assert math.isnan(message.param4)
    back = MissionItem.from_message(message)
    assert back.same_as(item)
    assert not back.same_as(waypoint(-53.1234567, 179.9999999, 33.25, frame=AMSL, hold_s=2.0))
    assert not back.same_as(waypoint(-53.1234567, 179.9999999, 33.30, frame=RELATIVE, hold_s=2.0))
    assert not back.same_as(waypoint(-53.1234560, 179.9999999, 33.25, frame=RELATIVE, hold_s=2.0))
    assert not back.same_as(waypoint(-53.1234567, 179.9999999, 33.25, frame=RELATIVE, hold_s=3.0))
    assert back.same_as(waypoint(-53.1234567, 179.9999999, 33.25, frame=RELATIVE, hold_s=3.0), parameters=False)


def test_a_fence_needs_three_corners() -> None:
    with pytest.raises(MissionItemError, match="at least 3 corners, not 2"):
        inclusion_fence([(53.0, 4.0), (53.0, 5.0)])


def test_a_list_nobody_can_count() -> None:
    with pytest.raises(MissionItemError, match="65536 items"):
        upload("px4", [MissionItem(16)] * 65_536)


# ---------------------------------------------------------------- the simulator, an independent witness


def fly_transfer(simulator: SimulatedAutopilot, transfer: MissionTransfer, *, limit_s: float = 200.0) -> None:
    """In virtual time, steps of 10 ms, 5 ms each way."""
    codec = StationCodec(241)
    now_s = 10.0
    for step in range(600):
        simulator.step(step * 0.01)
    simulator.take_outgoing()
    transfer.start(now_s)
    while transfer.running:
        assert now_s < limit_s, "the transfer never ends"
        for message in transfer.take_outgoing():
            simulator.receive(0, codec.encode(message), now_s)
        now_s += 0.01
        simulator.step(now_s)
        for _, frame in simulator.take_outgoing():
            for message in codec.decode(frame):
                transfer.receive(message, now_s)
        transfer.step(now_s)


def near(kind: str, count: int) -> list[MissionItem]:
    lat, lon = (47.397743, 8.545594) if kind == "px4" else (-35.363262, 149.165237)
    return [waypoint(lat + 1e-4 * i, lon + 1e-4 * i, 30.0 + i, frame=RELATIVE) for i in range(count)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "faults",
    [
        (),
        ("mission-ack-lost:2",),
        ("mission-request-lost:0.3",),
        ("mission-request-repeated:2",),
        ("mission-item-lost:0.3",),
    ],
)
def test_the_simulator_takes_a_mission(kind: str, faults: tuple[str, ...]) -> None:
    simulator = SimulatedAutopilot(SimulatorConfig(autopilot=kind, faults=faults, seed=5))
    transfer = upload(kind, near(kind, 12))
    fly_transfer(simulator, transfer)
    assert transfer.state is TransferState.DONE, transfer.failure


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("fault", "reason"),
    [("mission-refused", "refused"), ("mission-count-off:1", "silent"), ("mission-silent", "silent")],
)
def test_the_simulator_fails_us_cleanly(kind: str, fault: str, reason: str) -> None:
    simulator = SimulatedAutopilot(SimulatorConfig(autopilot=kind, faults=(fault,), seed=5))
    transfer = upload(kind, near(kind, 4))
    fly_transfer(simulator, transfer)
    assert transfer.failure is not None
    assert transfer.failure.reason == reason


@pytest.mark.parametrize("kind", KINDS)
def test_the_simulator_keeps_rally_points_and_forgets_them(kind: str) -> None:
    simulator = SimulatedAutopilot(SimulatorConfig(autopilot=kind))
    points = [rally_point(i.lat_deg, i.lon_deg, 40.0) for i in near(kind, 3)]
    transfer = upload(kind, points, mission_type=RALLY)
    fly_transfer(simulator, transfer)
    assert transfer.state is TransferState.DONE, transfer.failure
    emptying = clear(kind, mission_type=RALLY)
    fly_transfer(simulator, emptying)
    assert emptying.state is TransferState.DONE, emptying.failure
