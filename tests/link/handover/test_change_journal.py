"""What a flight changes on a vehicle is noted before it is changed, and given back by whoever comes next."""

from __future__ import annotations

import json
import math
import os
import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from gcs.flight import FlightState
from gcs.mission import read_mission
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission
from link.files.change_journal import FileJournal
from link.microservices.mission_item import AMSL, FENCE, RALLY, MissionItem
from link.session.changes import VehicleChanges
from sitl_fixtures.mavlink import Item
from tests.support.flights.forks import in_fork
from tests.support.flights.on_ground import checks, safe_plan
from tests.support.flights.virtual import VirtualFlight

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
OLD = Item(5100, 3, (0.0, 0.0, 0.0, 0.0), 529_505_000, 47_905_000, 12.0)
NAMES = ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS", "FENCE_TYPE", "FENCE_ENABLE")
TRIES = 24


def kept(one: VirtualFlight) -> tuple[Any, ...]:
    """What the vehicle holds of all a flight may borrow."""
    values = tuple(one.vehicle.parameters[n] for n in NAMES if n in one.vehicle.parameters)
    lists = tuple(tuple((i.x, i.y, i.z) for i in one.vehicle.missions.plans[kind]) for kind in (RALLY, FENCE))
    return values + lists


def borrowing(autopilot: str, journal: FileJournal, **settings: Any) -> tuple[VirtualFlight, tuple[Any, ...]]:
    """A flight that borrows everything, at its very beginning, and what the vehicle holds then."""
    request = {"auto_launch": False, "lay_geofence": True, **settings.pop("request", {})}
    one = VirtualFlight(safe_plan(), autopilot, frugal=True, request=request, journal=journal, **settings)
    one.vehicle.missions.plans[RALLY] = [OLD]
    return one, kept(one)


def ready(one: VirtualFlight) -> FlightState:
    return one.run(until=lambda: one.core.state is FlightState.READY, limit_s=400.0)


def ended(one: VirtualFlight) -> FlightState:
    one.core.command("abort")
    return one.run(limit_s=300.0)


def a_note(**changes: Any) -> VehicleChanges:
    items = (MissionItem(5100, 52.0, 4.0, 12.0, AMSL, (math.nan, 1.0, 2.0, 3.0)),)
    whole = VehicleChanges(
        "1-a", "flight", "ardupilot", 1, "uid2:0a", ("udpout:127.0.0.1:1",), (241, 242), signing_key="file:/key"
    )
    lists = {RALLY: (items, ())}
    return replace(whole, gcs_ids={"MAV_OPTIONS": 0}, settings={"FENCE_ENABLE": (0, 1)}, lists=lists, **changes)


# -- the journal ------------------------------------------------------------------------------------------------------


def test_a_note_is_read_as_it_was_written_and_never_holds_a_key(tmp_path: Path) -> None:
    journal = FileJournal(tmp_path, run_dir=tmp_path / "run")
    journal.keep(a_note())
    (read,) = FileJournal(tmp_path).pending()
    assert repr(read.lists) == repr(a_note().lists)  # NaN is not equal to itself
    assert (read.gcs_ids, read.settings, read.pid) == (a_note().gcs_ids, a_note().settings, os.getpid())
    assert "skyrelay vehicle restore --link udpout:127.0.0.1:1" in read.remedy
    (path,) = journal.folder.glob("*.json")
    assert path.stat().st_mode & 0o077 == 0
    journal.done("1-a")
    journal.done("1-a")
    assert journal.pending() == []


@pytest.mark.parametrize("damage", ["torn", "empty", "foreign", "newer"])
def test_a_damaged_note_hides_no_other_and_is_not_deleted(tmp_path: Path, damage: str) -> None:
    journal = FileJournal(tmp_path)
    journal.keep(a_note())
    journal.keep(replace(a_note(), key="2-b"))
    path = journal.folder / "2-b.json"
    whole = path.read_text()
    text = {"torn": whole[: len(whole) // 2], "empty": "", "foreign": "[]"}.get(damage)
    path.write_text(text if text is not None else json.dumps({**json.loads(whole), "version": 2}))
    assert [one.key for one in journal.pending()] == ["1-a"]
    assert journal.unreadable == [path]
    assert path.exists()


def test_a_note_is_of_a_vehicle_by_its_uid_and_else_by_id_and_link() -> None:
    note = a_note()
    assert note.is_of(9, "uid2:0a", ["udpout:elsewhere:1"])
    assert not note.is_of(1, "uid2:0b", note.urls)
    assert note.is_of(1, None, note.urls)
    assert not note.is_of(2, None, note.urls)
    assert not note.is_of(1, None, ["udpout:elsewhere:1"])


# -- flights ----------------------------------------------------------------------------------------------------------


@BOTH
def test_every_change_is_noted_before_it_reaches_the_vehicle(autopilot: str, tmp_path: Path) -> None:
    journal = FileJournal(tmp_path)
    one, before = borrowing(autopilot, journal)

    def noted_or_same() -> bool:
        if kept(one) != before:
            assert len(journal.pending()) == 1
        return one.core.state is FlightState.READY

    assert one.run(until=noted_or_same, limit_s=400.0) is FlightState.READY
    assert kept(one) != before
    (note,) = journal.pending()
    assert set(note.lists) == {RALLY, FENCE}
    assert ended(one) is FlightState.REFUSED
    assert kept(one) == before
    assert journal.pending() == []


@BOTH
def test_a_journal_that_cannot_be_written_leaves_the_vehicle_as_it_is(autopilot: str, tmp_path: Path) -> None:
    (tmp_path / "vehicles").write_text("in the way")
    one, before = borrowing(autopilot, FileJournal(tmp_path))
    assert ready(one) is FlightState.REFUSED
    assert kept(one) == before
    assert any("journal" in check["message"] for check in checks(one).values())


@BOTH
def test_the_next_flight_gives_back_before_it_takes_and_keeps_the_original(autopilot: str, tmp_path: Path) -> None:
    """With the same station ids: the lock of the dead flight is not the state to go back to."""
    journal = FileJournal(tmp_path)
    one, before = borrowing(autopilot, journal)
    assert ready(one) is FlightState.READY
    one.next_flight(journal, fence=True)
    assert ready(one) is FlightState.READY
    assert one.said("alarm", what="an earlier flight left this changed")
    assert len(journal.pending()) == 1
    assert ended(one) is FlightState.REFUSED
    assert kept(one) == before
    assert journal.pending() == []


@BOTH
@pytest.mark.slow
def test_killed_at_any_moment_the_next_flight_gives_all_back(autopilot: str, tmp_path: Path) -> None:
    """While it takes, while it gives back, and again while the second one gives back: seeded moments of each."""
    journal = FileJournal(tmp_path)
    one, before = borrowing(autopilot, journal)
    chance = random.Random(36)
    first_s = 0.0
    one.run(until=lambda: bool(journal.pending()), limit_s=400.0)
    first_s = one.now_s
    moments = sorted(chance.uniform(0.0, 14.0) for _ in range(TRIES))

    def killed_twice(give_up: bool, second_s: float) -> Any:
        if give_up and not one.core.finished:
            one.core.command("abort")
            one.run_for(second_s / 3.0)
        one.next_flight(journal, fence=True)
        one.run(until=lambda: one.now_s > stop_s, limit_s=60.0)
        one.next_flight(journal, rally=False)
        ready(one)
        return ended(one), kept(one), [n.texts for n in journal.pending()]

    for k, moment in enumerate(moments):
        one.run_for(max(0.0, first_s + moment - one.now_s))
        wait_s = chance.uniform(0.0, 20.0)
        stop_s = one.now_s + wait_s + 3.0
        folder = tmp_path / "vehicles"
        saved = {path.name: path.read_bytes() for path in folder.glob("*.json")}
        state, found, left = in_fork(lambda k=k, w=wait_s: killed_twice(k % 2 == 1, w))
        assert (state, left, found) == (FlightState.REFUSED, [], before), moment
        for path in folder.glob("*.json"):
            path.unlink()
        for name, data in saved.items():
            (folder / name).write_bytes(data)


def test_what_somebody_else_set_since_stays_and_is_told(tmp_path: Path) -> None:
    journal = FileJournal(tmp_path)
    one, _ = borrowing("ardupilot", journal)
    assert ready(one) is FlightState.READY
    one.vehicle.parameters.put("MAV_OPTIONS", 0)
    one.vehicle.parameters.put("MAV_GCS_SYSID", 77)
    one.next_flight(journal, rally=False)
    assert ready(one) is FlightState.READY
    assert one.said("alarm", name="MAV_GCS_SYSID", value=77)
    assert ended(one) is FlightState.REFUSED
    assert one.vehicle.parameters["MAV_GCS_SYSID"] == 77
    assert journal.pending() == []


def other_ids() -> Plan:
    document = dict(safe_plan().to_document()["mission"])
    document["stations"] = [{**s, "system_id": 101 + k} for k, s in enumerate(document["stations"])]
    return plan_mission(read_mission(document), fast=True)


def test_a_plan_with_other_ids_says_how_to_unlock_and_the_rescue_finds_the_original(tmp_path: Path) -> None:
    journal = FileJournal(tmp_path)
    one, before = borrowing("ardupilot", journal)
    assert ready(one) is FlightState.READY
    one.next_flight(journal, other_ids())
    assert ready(one) is FlightState.REFUSED
    (refusal,) = one.said("state", to="refused")
    for words in ("by flight flight", "skyrelay vehicle restore --link udpout:", "--rescue"):
        assert words in refusal.data["reason"]
    one.next_flight(journal, other_ids(), rescue=True)
    assert ready(one) is FlightState.READY
    assert ended(one) is FlightState.REFUSED
    assert kept(one) == before
    assert journal.pending() == []


def test_a_rescue_killed_in_its_middle_is_given_back_too(tmp_path: Path) -> None:
    """A lock nobody here noted is the original: it is what the vehicle gets back."""
    journal = FileJournal(tmp_path)
    one, _ = borrowing("ardupilot", journal, request={"rescue": True})
    lock = {"MAV_GCS_SYSID": 11, "MAV_GCS_SYSID_HI": 12, "MAV_OPTIONS": 1}
    for name, value in lock.items():
        one.vehicle.parameters.put(name, value)
    before = kept(one)
    one.run(until=lambda: one.vehicle.parameters["MAV_OPTIONS"] == 0, limit_s=300.0)
    assert len(journal.pending()) == 1
    one.next_flight(journal, rescue=True)
    assert ready(one) is FlightState.READY
    assert ended(one) is FlightState.REFUSED
    assert kept(one) == before
    assert journal.pending() == []
