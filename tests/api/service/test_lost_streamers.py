"""What the service does when a streamer, a file or the store fails it: nothing waits, nothing is forgotten."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from api.service.changes import Changes
from api.service.flight_journal import QueuedJournal
from api.service.flights import FlightService
from gcs.errors import ConflictError
from gcs.flight import EventKind, FlightEvent, FlightState
from gcs.settings import Settings
from gcs.store import Store
from link.errors import FlightRequestError
from link.streamer.supervisor import epitaph, events_of

UTC = "2026-11-22T09:00:00Z"


def event(number: int, state: FlightState = FlightState.CRUISE) -> FlightEvent:
    return FlightEvent(number, EventKind.COMMAND, float(number), None, UTC, state, {"name": "x"})


class SlowFlights:
    """A store whose database is held by somebody else."""

    def __init__(self, *, away_s: float) -> None:
        self.until_s = time.monotonic() + away_s
        self.written: list[int] = []
        self.flights = self

    def journal(self, flight_id: str) -> SlowFlights:
        return self

    def append(self, one: FlightEvent) -> None:
        self._held = one.sequence
        self.flush()

    def flush(self) -> bool:
        if time.monotonic() < self.until_s:
            time.sleep(0.05)
            return False
        if self.written[-1:] != [self._held]:
            self.written.append(self._held)
        return True


def test_who_hears_the_streamer_never_waits_for_the_store_and_the_history_catches_up() -> None:
    store = SlowFlights(away_s=1.0)
    journal = QueuedJournal(store, "f")  # type: ignore[arg-type]
    begun_s = time.monotonic()
    for number in range(1, 101):
        journal.append(event(number))
    assert time.monotonic() - begun_s < 0.5
    assert journal.wait(10.0)
    assert store.written == list(range(1, 101))
    assert not any(thread.name == "journal-f" for thread in threading.enumerate())


def lines(folder: Path, *torn: int, count: int = 6) -> None:
    """A run folder's events, those of the numbers ``torn`` cut in their middle, as a full disk leaves them."""
    folder.mkdir(parents=True, exist_ok=True)
    states = [FlightState.CRUISE] * (count - 1) + [FlightState.COMPLETED]
    whole = [json.dumps(event(k + 1, state).to_document()) for k, state in enumerate(states)]
    text = [line[: len(line) // 2] if k + 1 in torn else line for k, line in enumerate(whole)]
    (folder / "events.jsonl").write_text("\n".join(text) + "\n")


@pytest.mark.parametrize("torn", [(), (1,), (3,), (6,), (2, 5)])
def test_a_torn_line_of_the_events_costs_itself_alone(tmp_path: Path, torn: tuple[int, ...]) -> None:
    lines(tmp_path, *torn)
    assert [one.sequence for one in events_of(tmp_path)] == [k for k in range(1, 7) if k not in torn]


class Record:
    id = "f"


@pytest.mark.parametrize("torn", [(6,), (4, 5, 6), (1, 2, 3, 4, 5, 6)])
def test_the_result_file_says_how_a_flight_ended_whatever_lines_are_torn(tmp_path: Path, torn: tuple[int, ...]) -> None:
    from api.service.flight_status import FlightStatus

    lines(tmp_path, *torn)
    (tmp_path / "result.json").write_text(json.dumps({"state": "completed", "exit_code": 0}))
    kept: list[FlightEvent] = []

    class Kept:
        flights: Any = None

        def append(self, flight_id: str, one: FlightEvent) -> None:
            kept.append(one)

    store = Kept()
    store.flights = store
    service = FlightService(Settings(data_dir=tmp_path), store, Changes())  # type: ignore[arg-type]
    service._catch_up(Record(), tmp_path, FlightStatus())  # type: ignore[arg-type]
    assert kept[-1].state is FlightState.COMPLETED
    assert kept[-1].kind is EventKind.RESULT or 6 not in torn


def test_an_epitaph_says_what_the_vehicle_does_keeps_and_how_to_unlock_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from link.files import FileJournal
    from link.session.changes import VehicleChanges

    monkeypatch.setenv("SKYRELAY_STATE_DIR", str(tmp_path / "state"))
    run = tmp_path / "run"
    note = VehicleChanges("1-a", "f", "ardupilot", 1, None, ("serial:/dev/ttyUSB0:57600",), (241, 242))
    FileJournal(run_dir=run).keep(VehicleChanges(**{**note.__dict__, "gcs_ids": {"MAV_OPTIONS": 0}}))
    told = epitaph(run, airborne=True)
    assert "failsafe" in told["vehicle"]
    assert told["keeps"] == ["MAV_OPTIONS (was 0)"]
    assert "241 to 242 alone" in told["hears"]
    assert "skyrelay vehicle restore --link serial:/dev/ttyUSB0:57600 --ids-while-armed" in told["fix"]
    assert epitaph(tmp_path / "other", airborne=False) == {"vehicle": "disarmed", "keeps": []}


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ({"a": {"url": "udpout:127.0.0.1:1"}}, {"allow_unsigned": False}),
        ({"a": {"url": "serial:/dev/ttyUSB0:57600", "allow_unsigned": True}}, {"allow_unsigned": True}),
        ({"a": {"url": "serial:/dev/ttyUSB0:57600"}}, {"allow_unsigned": False}),
        (
            {"a": {"url": "udpout:192.0.2.1:1", "allow_unsigned": True}, "b": {"url": "udpout:192.0.2.2:1"}},
            {"allow_unsigned": False},
        ),
        ({"a": {"url": "udpout:192.0.2.1:1", "signing_key": "file:/k"}, "b": {"url": "tcp:h:1"}}, "file:/k"),
    ],
)
def test_a_link_entry_names_its_key_and_what_it_allows(tmp_path: Path, entries: Any, expected: Any) -> None:
    service = FlightService(Settings(data_dir=tmp_path), None, Changes())  # type: ignore[arg-type]
    found = service._security(entries)
    assert (found.get("signing_key") if isinstance(expected, str) else found) == expected


def test_one_vehicle_has_one_key(tmp_path: Path) -> None:
    service = FlightService(Settings(data_dir=tmp_path), None, Changes())  # type: ignore[arg-type]
    two = {k: {"url": "udpout:192.0.2.1:1", "signing_key": f"env:{k}"} for k in ("A", "B")}
    with pytest.raises(FlightRequestError, match="different signing keys"):
        service._security(two)


def test_what_is_in_flight_is_not_deleted_and_what_is_archived_not_flown(tmp_path: Path) -> None:
    with Store(f"sqlite:///{tmp_path / 'db'}") as store:
        mission_id = store.missions.add({"name": "m"})[0].id
        claimed = store.queue.claim("w", 60.0)
        assert claimed is not None
        store.queue.finish(claimed, "w", {"plan_sha256": "a" * 64})
        store.registry.put("link", "radio", {"url": "udpout:127.0.0.1:1"})
        store.registry.put("vehicle", "drone", {"autopilot": "px4", "links": {"*": "radio"}})
        given: Any = {"mission_id": mission_id, "version": 1, "plan_sha256": "a" * 64, "vehicle_id": "drone"}
        flight = store.flights.add(**given)
        for kind, name in (("vehicle", "drone"), ("link", "radio")):
            with pytest.raises(ConflictError, match=f"in use by flight {flight.id}"):
                store.registry.remove(kind, name)
        store.flights.append(flight.id, event(1, FlightState.REFUSED))
        store.missions.archive(mission_id)
        with pytest.raises(ConflictError, match="archived"):
            store.flights.add(**given)
        store.registry.remove("vehicle", "drone")
        store.registry.remove("link", "radio")
