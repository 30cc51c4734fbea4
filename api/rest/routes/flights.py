"""``/v1/flights``: a plan being flown, the operators' commands to it, and its telemetry."""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, WebSocket, WebSocketDisconnect
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from api.rest import schemas
from api.rest.bodies import StrictRoute
from api.rest.dependencies import Wired, services_of
from api.rest.problems import ApiError
from api.rest.routes import shared
from api.rest.routes.plans import planned
from api.rest.routes.shared import Cursor, Limit, MissionId
from api.service import FlightStatus, Services, outer_state
from gcs.flight import OperatorCommand
from gcs.store import FlightRecord

router = APIRouter(prefix="/v1/flights", tags=["flights"], route_class=StrictRoute)

FlightId = Annotated[str, Path(max_length=64, pattern=r"^[0-9A-Za-z_-]+$")]
HandoverIndex = Annotated[int, Path(ge=1, le=100_000, description="As in the plan, from 1.")]
# Telemetry at most so often; sooner only when something else than the position changes.
_TELEMETRY_S = 0.2
_QUIET_S = 15.0
_RESULT_S = 2.0


def shown(services: Services, record: FlightRecord, *, whole: bool) -> dict[str, Any]:
    """A flight as `schemas.FlightSummary`, or with everything known (``whole``) as `schemas.FlightDetail`."""
    status = services.flights.look(record.id) if whole else FlightStatus(state=record.state)
    state = status.state if whole and status.sequence else record.state
    body: dict[str, Any] = {
        "id": record.id,
        "mission_id": record.mission_id,
        "version": record.version,
        "plan_sha256": record.plan_sha256,
        "vehicle_id": record.vehicle_id,
        "state": outer_state(state),
        "phase": state.value,
        "created_utc": record.created_utc,
        "changed_utc": record.changed_utc,
        # The record may be one event ahead of what is known here: one answer tells one moment.
        "ended_utc": record.ended_utc if state.ended else None,
    }
    if whole:
        body |= {
            "preflight": {
                "id": status.preflight_id,
                "passed": status.passed,
                "age_s": services.flights.preflight_age_s(record.id),
                "checks": status.checks,
            },
            "live": status.live(),
            "handover_states": {str(index): state for index, state in sorted(status.handovers.items())},
            "alarms": status.alarms,
            "result": status.result,
        }
    return body


@router.post(
    "",
    summary="Make a flight of a plan",
    status_code=201,
    responses={201: {"model": schemas.FlightDetail, "description": "In preflight; nothing is armed."}},
)
def create(services: Wired, body: schemas.NewFlight) -> Response:
    """Connects to the vehicle over its C2 links and judges it: see `preflight` of the answer's address."""
    with shared.domain_errors():
        record = services.store.missions.get(body.mission_id, body.version)
        record = planned(services, body.mission_id, body.version)
        if record.plan_sha256 != body.plan_sha256:
            raise shared.conflict(f"the mission's plan is {record.plan_sha256}, not {body.plan_sha256}")
        options = body.model_dump(exclude={"mission_id", "plan_sha256", "vehicle_id", "version"}, exclude_none=True)
        flight = services.flights.create(
            services.plan_of(record),
            mission_id=record.id,
            version=record.version,
            vehicle_id=body.vehicle_id,
            options=options,
        )
        content = shown(services, flight, whole=True)
    return JSONResponse(content, status_code=201, headers={"Location": f"/v1/flights/{flight.id}"})


@router.get("", summary="List flights")
def list_flights(
    services: Wired,
    limit: Limit = 50,
    cursor: Cursor = None,
    mission_id: Annotated[
        str | None, Query(max_length=64, pattern=shared.PLAIN_ID, description="Only those of this mission.")
    ] = None,
    active: Annotated[bool, Query(description="Only those that have not ended.")] = False,
) -> schemas.FlightPage:
    """Newest first, a page at a time."""
    with shared.domain_errors():
        records = services.store.flights.page(
            limit=limit + 1, before=shared.cursor_number(cursor), mission_id=mission_id, active=active
        )
        items = [shown(services, record, whole=False) for record in records[:limit]]
    more = str(records[limit - 1].number) if len(records) > limit else None
    return schemas.FlightPage.model_validate({"items": items, "next": more})


@router.get("/{flight_id}", summary="Look at a flight")
def get_flight(services: Wired, flight_id: FlightId) -> schemas.FlightDetail:
    """State, preflight, where it is, alarms, how it ended."""
    with shared.domain_errors():
        body = shown(services, services.flights.record(flight_id), whole=True)
    return schemas.FlightDetail.model_validate(body)


@router.get("/{flight_id}/events", summary="Read a flight's history")
def events(
    services: Wired,
    flight_id: FlightId,
    after: Annotated[int, Query(ge=0, le=2**31 - 1, description="Sequence number of the last event known.")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
) -> schemas.FlightEvents:
    """Events in order, append-only: states, checks, operator commands, handovers, alarms, now and then a position."""
    with shared.domain_errors():
        services.flights.settle(flight_id)
        services.store.flights.get(flight_id)
        found = services.store.flights.events(flight_id, after=after, limit=limit)
    return schemas.FlightEvents.model_validate({"items": [event.to_document() for event in found]})


@router.post("/{flight_id}/launch", summary="Arm and go")
def launch(services: Wired, flight_id: FlightId, body: schemas.LaunchCommand) -> schemas.FlightDetail:
    """Needs the plan's hash and a preflight that has passed and is under 60 s old."""
    with shared.domain_errors():
        services.flights.launch(
            flight_id, plan_sha256=body.plan_sha256, preflight_id=body.preflight_id, by=body.by or "REST"
        )
    return get_flight(services, flight_id)


@router.post("/{flight_id}/preflight", summary="Make the preflight again")
def preflight(services: Wired, flight_id: FlightId, body: schemas.CommandBody | None = None) -> schemas.FlightDetail:
    """Before the launch command, which needs one under 60 s old: the vehicle and its links are judged anew."""
    return _command(services, flight_id, OperatorCommand.PREFLIGHT, body)


def _command(
    services: Services, flight_id: str, command: OperatorCommand, body: schemas.CommandBody | None, **fields: Any
) -> schemas.FlightDetail:
    given = body or schemas.CommandBody(by=None, reason=None)
    with shared.domain_errors():
        services.flights.command(flight_id, command, by=given.by or "REST", reason=given.reason or "", **fields)
    return get_flight(services, flight_id)


@router.post("/{flight_id}/hold", summary="Stop on the path")
def hold(services: Wired, flight_id: FlightId, body: schemas.CommandBody | None = None) -> schemas.FlightDetail:
    """The stream goes on with zero velocity; the schedule shifts."""
    return _command(services, flight_id, OperatorCommand.HOLD, body)


@router.post("/{flight_id}/resume", summary="Go on after a hold")
def resume(services: Wired, flight_id: FlightId, body: schemas.CommandBody | None = None) -> schemas.FlightDetail:
    """Coverage is checked again and the schedule re-timed."""
    return _command(services, flight_id, OperatorCommand.RESUME, body)


@router.post("/{flight_id}/abort", summary="Fly the contingency procedure in force")
def abort(services: Wired, flight_id: FlightId, body: schemas.CommandBody | None = None) -> schemas.FlightDetail:
    """On the ground: give the flight up."""
    return _command(services, flight_id, OperatorCommand.ABORT, body)


@router.post("/{flight_id}/land", summary="Land where the vehicle is")
def land(services: Wired, flight_id: FlightId, body: schemas.CommandBody | None = None) -> schemas.FlightDetail:
    """At once, wherever that is."""
    return _command(services, flight_id, OperatorCommand.LAND, body)


def _flown_plan(services: Services, flight_id: str, plan_sha256: str) -> dict[str, Any]:
    """A plan this flight has flown: its mission's, or one it was given in the air."""
    record = services.store.flights.get(flight_id)
    if plan_sha256 == record.plan_sha256:
        mission = services.store.missions.get(record.mission_id, record.version)
        return dict(services.plan_of(mission).to_document())
    return services.flights.replanned(flight_id, plan_sha256)


@router.post("/{flight_id}/replan", summary="Plan on from the present state")
def replan(services: Wired, flight_id: FlightId, body: schemas.ReplanRequest | None = None) -> schemas.ReplanProposal:
    """A new plan from where the flight stands, or from a moment ahead, for a person to accept; nothing changes yet.

    Flown from launch to the new end it is one plan: the part already flown, and the new one joined on without a jump.
    """
    asked = body or schemas.ReplanRequest.model_validate({})
    with shared.domain_errors():
        proposal = services.replanning.propose(
            flight_id,
            lambda sha256: _flown_plan(services, flight_id, sha256),
            destination=asked.destination,
            excluded_stations=asked.excluded_stations,
            ahead_s=asked.ahead_s,
        )
    return schemas.ReplanProposal.model_validate(proposal.to_document())


@router.post("/{flight_id}/replan/accept", summary="Fly a proposed plan")
def accept_replan(services: Wired, flight_id: FlightId, body: schemas.ReplanCommand) -> schemas.FlightDetail:
    """The streamer judges it once more; handovers and contingencies are those of the new plan from now on."""
    with shared.domain_errors():
        services.store.flights.get(flight_id)
        services.replanning.accept(flight_id, body.plan_sha256, by=body.by or "REST", reason=body.reason or "")
    return get_flight(services, flight_id)


@router.get(
    "/{flight_id}/plan",
    summary="Fetch the plan being flown",
    responses={200: {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/PlanBody"}}}}},
)
def flown_plan(services: Wired, flight_id: FlightId) -> Response:
    """The mission's plan, or the last one the flight was given in the air."""
    with shared.domain_errors():
        record = services.store.flights.get(flight_id)
        sha256 = services.flights.look(flight_id).plan_sha256 or record.plan_sha256
        return JSONResponse(_flown_plan(services, flight_id, sha256))


@router.post("/{flight_id}/handovers/{index}/ready", summary="Stand by to receive control")
def ready(
    services: Wired, flight_id: FlightId, index: HandoverIndex, body: schemas.CommandBody | None = None
) -> schemas.FlightDetail:
    """The receiving station's crew stands by."""
    return _command(services, flight_id, OperatorCommand.READY, body, handover=index)


@router.post("/{flight_id}/handovers/{index}/accept", summary="Accept a handover")
def accept(
    services: Wired, flight_id: FlightId, index: HandoverIndex, body: schemas.CommandBody | None = None
) -> schemas.FlightDetail:
    """As `ready`, and takes a refusal back."""
    return _command(services, flight_id, OperatorCommand.ACCEPT, body, handover=index)


@router.post("/{flight_id}/handovers/{index}/refuse", summary="Refuse a handover")
def refuse(
    services: Wired, flight_id: FlightId, index: HandoverIndex, body: schemas.CommandBody | None = None
) -> schemas.FlightDetail:
    """The transferring station stays in control; the flight waits before the next range, then flies the contingency
    procedure.
    """
    return _command(services, flight_id, OperatorCommand.REFUSE, body, handover=index)


@router.websocket("/{flight_id}/telemetry")
async def telemetry(socket: WebSocket, flight_id: MissionId) -> None:
    """The live state (`live` of a flight) as JSON: now, and whenever it changes, until the flight ends."""
    services = services_of(socket)

    def look() -> FlightStatus:
        with shared.domain_errors():
            services.flights.record(flight_id)
            return services.flights.look(flight_id)

    await socket.accept()
    try:
        status = await run_in_threadpool(look)
    except ApiError as error:
        await socket.close(code=4404 if error.status == 404 else 1011, reason=error.detail[:120])
        return
    gone = asyncio.ensure_future(_until_gone(socket))
    try:
        with services.changes.watch(flight_id) as changed:
            ended_s = 0.0
            while not gone.done():
                changed.clear()
                sent_s = time.monotonic()
                await socket.send_json({"flight_id": flight_id, **status.live()})
                if status.state.ended:
                    # The figures follow the end by a moment.
                    ended_s = ended_s or sent_s
                    if status.result is not None or sent_s - ended_s > _RESULT_S:
                        await socket.close(code=1000)
                        return
                waiting = asyncio.ensure_future(changed.wait())
                await asyncio.wait(
                    {waiting, gone}, timeout=_RESULT_S if ended_s else _QUIET_S, return_when=asyncio.FIRST_COMPLETED
                )
                waiting.cancel()
                await asyncio.sleep(max(0.0, _TELEMETRY_S - (time.monotonic() - sent_s)))
                status = await run_in_threadpool(services.flights.look, flight_id)
    except (WebSocketDisconnect, RuntimeError):
        return
    finally:
        gone.cancel()


async def _until_gone(socket: WebSocket) -> None:
    """Read and ignore what the other side sends, until it closes."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
