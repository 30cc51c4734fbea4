"""Flights of the service: started, commanded, watched. A streamer outlives the service, which finds it again.

Wires `link.streamer.supervisor` (processes), the store (records and history) and those who watch. Everything here may
block and is called from threads; the streamer's events come on a thread of their own.
"""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import structlog

from api.service.changes import Changes
from api.service.flight_journal import QueuedJournal
from api.service.flight_status import FlightStatus
from api.service.vehicles import Restorer
from gcs.errors import ConflictError, InputFault, NotFoundError, StoreError
from gcs.exports import write_atomic
from gcs.flight import EventKind, FlightEvent, FlightState, OperatorCommand, TransitionError
from gcs.plan import Plan
from gcs.settings import Settings
from gcs.store import FlightRecord, Store
from gcs.timestamps import utc_now_text
from link.director import PREFLIGHT_VALID_S
from link.errors import FlightRequestError, LinkError, SupervisorError
from link.session import FlightRequest
from link.streamer import RunningFlight, attach, epitaph, events_of, start_flight
from link.transport import is_local

log = structlog.get_logger("api.flights")

# How long the end of the service waits for vehicles to be given back what was changed; a streamer goes on without it.
_RESTORATION_S = 60.0
_SETTLE_S = 2.0
_PROPOSALS_KEPT = 20


@dataclass
class _Watched:
    """A flight whose streamer runs, as far as known. ``flight`` is None until it is connected.

    ``record`` is the store's of its beginning: what does not change is known without the store.
    """

    status: FlightStatus
    record: FlightRecord
    journal: QueuedJournal
    flight: RunningFlight | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)


class FlightService:
    """All flights of a service."""

    def __init__(self, settings: Settings, store: Store, changes: Changes, owner: str | None = None) -> None:
        self._settings = settings
        self._store = store
        self._changes = changes
        self._owner = owner
        self._watched: dict[str, _Watched] = {}
        self.restorer = Restorer(settings.data_dir)

    # -- starting -----------------------------------------------------------------------------------------------------

    def create(
        self, plan: Plan, *, mission_id: str, version: int, vehicle_id: str, options: Mapping[str, Any]
    ) -> FlightRecord:
        """A flight of ``plan``, its streamer started; nothing is armed before the launch command.

        Raises `gcs.errors.NotFoundError` (vehicle or link), `ConflictError` (the vehicle flies, the plan is another),
        `link.errors.FlightRequestError` and `SupervisorError`.
        """
        vehicle = self._store.registry.get("vehicle", vehicle_id).document
        links, security = self._links(plan, vehicle)
        asked = {"plan": plan.to_document(), "autopilot": vehicle["autopilot"], "links": links, "auto_launch": False}
        request = FlightRequest.from_document({**asked, **options, **security})
        for other in [one for one in list(self._watched.values()) if one.record.vehicle_id == vehicle_id]:
            other.journal.wait(_SETTLE_S)  # that its last flight has ended must be in the store
        record = self._store.flights.add(
            mission_id=mission_id,
            version=version,
            plan_sha256=plan.plan_sha256,
            vehicle_id=vehicle_id,
            owner=self._owner,
            document={"autopilot": vehicle["autopilot"], "links": links, "options": dict(options)},
        )
        folder = self._folder(record.id)
        document = {**record.document, "run_dir": str(folder)}
        record = self._store.flights.update(record.id, document)
        watched = self._watched[record.id] = _Watched(FlightStatus(), record, QueuedJournal(self._store, record.id))
        try:
            sent = replace(request, flight_id=record.id, log_path=str(folder / "flight.tlog"))
            watched.flight = start_flight(sent, watched.journal, self._listener(record.id, watched), run_dir=folder)
        except (LinkError, OSError) as error:
            del self._watched[record.id]
            self._end_unstarted(record.id, str(error))
            raise
        return self._store.flights.get(record.id)

    def _links(self, plan: Plan, vehicle: Mapping[str, Any]) -> tuple[dict[str, str], dict[str, Any]]:
        """A URL for each station of the plan, by the vehicle's link names, and how those links are signed.

        And for those in reserve, which have an id in the mission and a link of their own.
        """
        names: dict[str, str] = vehicle["links"]
        entries: dict[str, dict[str, Any]] = {}
        reserve = [s.id for s in plan.mission.stations if s.system_id is not None and s.id in names]
        for station in dict.fromkeys([*plan.station_ids, *reserve]):
            name = names.get(station, names.get("*"))
            if name is not None:
                entries[station] = self._store.registry.get("link", name).document
        return {station: str(entry["url"]) for station, entry in entries.items()}, self._security(entries)

    def _security(self, entries: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The fields of a request by what the link entries say: one vehicle, one key.

        Raises `link.errors.FlightRequestError` where they name two.
        """
        keys = {entry["signing_key"]: station for station, entry in entries.items() if entry.get("signing_key")}
        if len(keys) > 1:
            where = ", ".join(keys.values())
            what, fix = "the links name different signing keys", "a vehicle has one key: name the same in all its links"
            raise FlightRequestError([InputFault("links", what, where, "one key", fix)])
        if keys:
            state = self._settings.data_dir / "signing"
            state.mkdir(mode=0o700, parents=True, exist_ok=True)
            return {"signing_key": next(iter(keys)), "signing_state": str(state)}
        away = [entry for entry in entries.values() if not is_local(str(entry["url"]))]
        # What an entry does not allow, the streamer refuses and says why.
        return {"allow_unsigned": bool(away) and all(entry.get("allow_unsigned") for entry in away)}

    def _folder(self, flight_id: str) -> Path:
        """Where a flight's streamer keeps its things."""
        folder = self._settings.data_dir / "flights" / flight_id
        folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        return folder

    def _end_unstarted(self, flight_id: str, why: str) -> None:
        now = utc_now_text()
        data = {"from": FlightState.CONNECTING.value, "to": FlightState.REFUSED.value, "reason": why}
        event = FlightEvent(1, EventKind.STATE, 0.0, None, now, FlightState.REFUSED, data)
        with contextlib.suppress(StoreError):
            self._store.flights.append(flight_id, event)

    def _listener(self, flight_id: str, watched: _Watched) -> Any:
        def on_event(event: FlightEvent) -> None:
            with watched.lock:
                watched.status.apply(event)
            self._changes.tell(flight_id)
            if event.data.get("what") == "streamer died":
                self.restorer.start()
            if event.kind is EventKind.IDENTITY:
                # Not here: the store may be slow, and the streamer's answers come on this thread.
                identity = str(event.data["identity"])
                threading.Thread(target=self._claim, args=(flight_id, watched, identity), daemon=True).start()

        return on_event

    def _claim(self, flight_id: str, watched: _Watched, identity: str) -> None:
        """Note which vehicle it is; end a flight of a vehicle that is on another. At launch it is asked for again."""
        try:
            self._store.flights.claim(flight_id, identity)
        except ConflictError as error:
            log.error("two flights of one vehicle", flight=flight_id, error=str(error))
            with contextlib.suppress(TransitionError, SupervisorError):
                if watched.flight is not None:
                    watched.flight.command(OperatorCommand.ABORT, by="service", reason=str(error))
        except (StoreError, NotFoundError) as error:
            log.warning("the vehicle of a flight is not noted yet", flight=flight_id, error=str(error))

    # -- finding again ------------------------------------------------------------------------------------------------

    def reattach(self) -> None:
        """Connect to the streamers of flights that had not ended when the service last did."""
        for record in self._store.flights.page(limit=1000, active=True):
            if not self._ours(record):
                continue
            try:
                self._reattach(record)
            except StoreError as error:
                log.warning("flight not found again", flight=record.id, error=str(error))
        self.restorer.start()

    def _ours(self, record: FlightRecord) -> bool:
        """Whether a flight is this service's to find again, and to end where its streamer is gone."""
        if record.owner is not None:
            return record.owner == self._owner
        return self._settings.database_url is None or Path(record.document.get("run_dir") or "/nonexistent").is_dir()

    def _reattach(self, record: FlightRecord) -> None:
        folder = Path(record.document.get("run_dir") or "/nonexistent")
        status = self._status_of(record.id)
        watched = _Watched(status, record, QueuedJournal(self._store, record.id))
        listener = self._listener(record.id, watched)
        try:
            watched.flight = attach(folder, watched.journal, listener, after=status.sequence)
        except SupervisorError:
            self._catch_up(record, folder, status)
            return
        self._watched[record.id] = watched
        log.info("flight found again", flight=record.id, state=status.state.value)

    def _catch_up(self, record: FlightRecord, folder: Path, status: FlightStatus) -> None:
        """No streamer runs any more: take over what it wrote meanwhile, and say how it ended."""
        journal = self._store.flights
        for event in events_of(folder):
            if event.sequence > status.sequence:
                journal.append(record.id, event)
                status.apply(event)
        if status.state.ended:
            return
        airborne = status.state.airborne or status.state is FlightState.ARMING
        state = FlightState.LOST if airborne else FlightState.REFUSED
        data = {"what": "the streamer died while the service was away", "from": status.state.value}
        kind, data = EventKind.ALARM, data | epitaph(folder, airborne=airborne)
        with contextlib.suppress(OSError, ValueError, KeyError):
            # How it ended is written once, and says more than events that a full disk may have swallowed.
            result = json.loads((folder / "result.json").read_bytes())
            state, kind, data = FlightState(result["state"]), EventKind.RESULT, {"outcome": result["state"], **result}
        event = FlightEvent(status.sequence + 1, kind, 0.0, status.t_plus_s, utc_now_text(), state, data)
        journal.append(record.id, event)
        log.error("flight found ended", flight=record.id, state=state.value)

    def close(self) -> None:
        """Let go of flights in the air, which go on as far as authorised; end those that never left the ground.

        Vehicles get back what was changed; what takes longer the streamer finishes alone, or the next service.
        """
        self.restorer.stop()
        deadline = time.monotonic() + _RESTORATION_S
        waiting = []
        for flight_id, watched in list(self._watched.items()):
            flight, state = watched.flight, watched.status.state
            if flight is None or flight.result is not None:
                continue
            if state.airborne or state is FlightState.ARMING:
                log.warning("the flight goes on without the service", flight=flight_id, streamer=flight.pid)
                flight.detach()
                continue
            if not state.ended:
                with contextlib.suppress(TransitionError, SupervisorError):
                    flight.command(OperatorCommand.ABORT, by="service", reason="the service ends")
            waiting.append((flight_id, flight))
        for flight_id, flight in waiting:
            with contextlib.suppress(SupervisorError, TimeoutError):
                flight.wait(max(0.0, deadline - time.monotonic()))
            if flight.result is None:
                log.warning("the vehicle is still given back what was changed", flight=flight_id, streamer=flight.pid)
                flight.detach()
        for watched in self._watched.values():
            watched.journal.wait(max(0.0, min(5.0, deadline - time.monotonic())))
        self._watched.clear()

    # -- commanding ---------------------------------------------------------------------------------------------------

    def command(self, flight_id: str, command: OperatorCommand, **fields: Any) -> None:
        """Give a flight an operator command.

        Raises `gcs.errors.NotFoundError`, `ConflictError` (it has ended), `TransitionError` (it cannot be given now),
        `SupervisorError`.
        """
        self._running(flight_id).command(command, **fields)

    def launch(self, flight_id: str, *, plan_sha256: str, preflight_id: int, by: str) -> None:
        """The launch command: for this plan, on this preflight, which has passed and is under 60 s old.

        Raises as `command` does.
        """
        flight = self._running(flight_id)
        status = flight.status()
        if status["plan_sha256"] != plan_sha256:
            raise ConflictError(f"the flight is of plan {status['plan_sha256']}, not {plan_sha256}")
        if status["state"] != FlightState.READY.value:
            raise ConflictError(f"the preflight has not passed: the flight is {status['state']}")
        if status["preflight_id"] != preflight_id:
            raise ConflictError(f"the last preflight is {status['preflight_id']}, not {preflight_id}")
        age_s = float(status["preflight_age_s"] or 0.0)
        if age_s >= PREFLIGHT_VALID_S:
            raise ConflictError(
                f"the preflight is {age_s:.0f} s old, allowed is under {PREFLIGHT_VALID_S:.0f} s; "
                "have it made again (preflight)"
            )
        identity = status.get("vehicle_identity")
        if identity is not None:
            self._store.flights.claim(flight_id, str(identity))
        flight.command(OperatorCommand.LAUNCH, by=by, plan_sha256=plan_sha256)

    def replan(self, flight_id: str, document: Mapping[str, Any], **fields: Any) -> None:
        """Give a flight another plan to fly from here on. Raises as `command` does."""
        self._running(flight_id).replan(document, **fields)

    def keep_proposal(self, flight_id: str, proposal: Mapping[str, Any]) -> None:
        """Keep a plan proposed to a flight, by the plan's hash, in its run folder: a service that starts anew finds it.

        The last `_PROPOSALS_KEPT` are kept.
        """
        folder = self._run_dir(flight_id)
        write_atomic(folder / f"proposal-{proposal['plan']['plan_sha256']}.json", json.dumps(proposal, allow_nan=False))
        by_age = sorted(folder.glob("proposal-*.json"), key=lambda path: path.stat().st_mtime_ns)
        for path in by_age[:-_PROPOSALS_KEPT]:
            path.unlink(missing_ok=True)

    def proposal(self, flight_id: str, plan_sha256: str) -> dict[str, Any]:
        """What `keep_proposal` kept. Raises `NotFoundError`."""
        try:
            kept: dict[str, Any] = json.loads((self._run_dir(flight_id) / f"proposal-{plan_sha256}.json").read_bytes())
        except (OSError, ValueError):
            raise NotFoundError(
                f"no plan {plan_sha256} is proposed to flight {flight_id}: ask for one and accept that"
            ) from None
        return kept

    def request(self, flight_id: str) -> FlightRequest:
        """What a flight was asked to do. Raises `NotFoundError`."""
        try:
            return FlightRequest.from_document(json.loads((self._run_dir(flight_id) / "request.json").read_bytes()))
        except (OSError, ValueError):
            raise NotFoundError(f"what flight {flight_id} was asked to do is not kept any more") from None

    def _run_dir(self, flight_id: str) -> Path:
        return Path(self._store.flights.get(flight_id).document.get("run_dir") or "/nonexistent")

    def streamer_status(self, flight_id: str) -> dict[str, Any]:
        """What the streamer says of a flight now. Raises as `command` does, but no `TransitionError`."""
        return self._running(flight_id).status()

    def replanned(self, flight_id: str, plan_sha256: str) -> dict[str, Any]:
        """A plan that was given to a flight in the air. Raises `NotFoundError`."""
        folder = self._run_dir(flight_id)
        try:
            document: dict[str, Any] = json.loads((folder / f"plan-{plan_sha256}.json").read_bytes())
        except (OSError, ValueError):
            raise NotFoundError(f"flight {flight_id} was not given a plan {plan_sha256}") from None
        return document

    def _running(self, flight_id: str) -> RunningFlight:
        watched = self._watched.get(flight_id)
        if watched is None or watched.flight is None or watched.flight.result is not None:
            state = self._store.flights.get(flight_id).state if watched is None else watched.status.state
            raise ConflictError(f"flight {flight_id} is {state.value} and takes no commands any more")
        return watched.flight

    def record(self, flight_id: str) -> FlightRecord:
        """A flight's record: of one that runs here without asking the store, its state by its events.

        Raises `NotFoundError`, `StoreUnavailable`.
        """
        watched = self._watched.get(flight_id)
        if watched is None:
            return self._store.flights.get(flight_id)
        status, kept = watched.status, watched.record
        ended_utc = status.ended_utc or kept.ended_utc
        return replace(kept, state=status.state, changed_utc=status.utc or kept.changed_utc, ended_utc=ended_utc)

    def settle(self, flight_id: str) -> None:
        """Let what a flight's history still has on its way reach the store, for a moment at most."""
        if (watched := self._watched.get(flight_id)) is not None:
            watched.journal.wait(_SETTLE_S)

    # -- looking ------------------------------------------------------------------------------------------------------

    def look(self, flight_id: str) -> FlightStatus:
        """What a flight's events amount to now: from memory while it runs here, else from the store."""
        watched = self._watched.get(flight_id)
        return self._status_of(flight_id) if watched is None else watched.status

    def _status_of(self, flight_id: str) -> FlightStatus:
        status, after = FlightStatus(), 0
        while events := self._store.flights.events(flight_id, after=after):
            for event in events:
                status.apply(event)
            after = events[-1].sequence
        return status

    def preflight_age_s(self, flight_id: str) -> float | None:
        """Age of a running flight's last preflight, wall seconds; None where there is none or nobody to ask."""
        watched = self._watched.get(flight_id)
        if watched is None or watched.flight is None or watched.flight.result is not None:
            return None
        try:
            age = watched.flight.status()["preflight_age_s"]
        except SupervisorError:
            return None
        return None if age is None else float(age)

    def counts(self) -> dict[str, int]:
        """Running flights by state."""
        found: dict[str, int] = {}
        for watched in list(self._watched.values()):
            if watched.flight is not None and watched.flight.result is None:
                state = watched.status.state.value
                found[state] = found.get(state, 0) + 1
        return found
