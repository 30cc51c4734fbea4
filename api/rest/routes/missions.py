"""``/v1/missions``: sent, listed, looked at, given new versions, put away; and their planning watched."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query
from sse_starlette import EventSourceResponse, ServerSentEvent
from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse, Response

from api.rest import schemas
from api.rest.bodies import StrictRoute
from api.rest.dependencies import Wired
from api.rest.routes import shared
from api.rest.routes.shared import Cursor, IdempotencyKey, Limit, MissionId, RawBody, Version
from api.service import Services
from gcs.exports import FORMATS as HANDOVER_FORMATS
from gcs.mission import parse_mission_json, write_mission
from gcs.store import MissionRecord
from link.files import FORMATS as SETPOINT_FORMATS

router = APIRouter(prefix="/v1/missions", tags=["missions"], route_class=StrictRoute)

FORMATS = {"handovers": list(HANDOVER_FORMATS), "setpoints": list(SETPOINT_FORMATS), "export": list[str]()}
# Events are pushed; this often the store is looked at as well, for planners that run elsewhere.
_POLL_S = 1.0
_DONE = ("planned", "infeasible", "failed")
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            "application/json": {
                "schema": {"$ref": "#/components/schemas/MissionBody"},
                "examples": {
                    "geographic": {"summary": "Latitude and longitude", "value": schemas.MISSION_EXAMPLE},
                    "local": {"summary": "Metres on a map plane", "value": schemas.LOCAL_MISSION_EXAMPLE},
                },
            }
        },
    }
}
_EVENT = {
    "type": "object",
    "properties": {
        "event": {"enum": ["progress", "done"]},
        "id": {"type": "string", "description": "`changed_utc` of the mission."},
        "data": {"type": "string", "description": "A mission summary, as JSON."},
    },
}
_CREATED: dict[int | str, dict[str, Any]] = {
    201: {
        "model": schemas.MissionSummary,
        "description": "Stored; planning has been queued.",
        "headers": {"Location": {"description": "Where the mission is.", "schema": {"type": "string"}}},
    }
}


def summary(record: MissionRecord) -> dict[str, Any]:
    """A version as `schemas.MissionSummary`."""
    return {
        "id": record.id,
        "name": record.name,
        "version": record.version,
        "latest_version": record.latest_version,
        "status": record.status,
        "progress": {"phase": record.phase, "fraction": record.progress},
        "plan_sha256": record.plan_sha256,
        "mission_time_s": record.mission_time_s,
        "handover_count": record.handover_count,
        "problem": problem_of(record),
        "created_utc": record.created_utc,
        "changed_utc": record.changed_utc,
        "archived_utc": record.archived_utc,
    }


def problem_of(record: MissionRecord) -> dict[str, Any] | None:
    """Why a version has no plan, as `schemas.MissionProblem`; None while it may get one or has it."""
    if record.infeasibility is not None:
        found = record.infeasibility
        return {
            "title": "No flight can fulfil this mission",
            "detail": found.get("message"),
            "reason": found.get("reason"),
            "place": found.get("where"),
            "gap_m": found.get("gap_m"),
            "stations": found.get("stations"),
            "fix": found.get("fix"),
            "fix_text": found.get("fix_text"),
            "causes": found.get("causes") or [],
        }
    if record.error is not None:
        return {"title": "Planning failed", "detail": record.error}
    return None


def _created(services: Services, record: MissionRecord, is_new: bool) -> Response:
    if is_new:
        services.pool.wake()
        services.changes.tell(record.id)
    headers = {"Location": f"/v1/missions/{record.id}?version={record.version}"}
    if record.version == 1:
        headers["Location"] = f"/v1/missions/{record.id}"
    if not is_new:
        headers["Idempotent-Replayed"] = "true"
    return JSONResponse(summary(record), status_code=201, headers=headers)


@router.post("", summary="Send a mission to be planned", status_code=201, responses=_CREATED, openapi_extra=_BODY)
def create(services: Wired, body: RawBody, key: IdempotencyKey = None) -> Response:
    """Stores a sound mission and queues its planning; a malformed one is answered with every fault, and not stored."""
    with shared.domain_errors():
        settings = services.settings
        mission = parse_mission_json(body, max_bytes=settings.max_document_bytes, max_stations=settings.max_stations)
        record, is_new = services.store.missions.add(
            write_mission(mission),
            idempotency=shared.idempotency("POST /v1/missions", key, body),
            max_queued=settings.max_queued_missions,
        )
        return _created(services, record, is_new)


@router.get("", summary="List missions")
def list_missions(
    services: Wired,
    limit: Limit = 50,
    cursor: Cursor = None,
    status: Annotated[schemas.Status | None, Query(description="Only these.")] = None,
    archived: Annotated[bool, Query(description="Those put away, too.")] = False,
) -> schemas.MissionPage:
    """The latest version of every mission, newest first, a page at a time."""
    with shared.domain_errors():
        before = shared.cursor_number(cursor)
        records = services.store.missions.page(limit=limit + 1, before=before, archived=archived, status=status)
        items = [summary(record) for record in records[:limit]]
    more = str(records[limit - 1].number) if len(records) > limit else None
    return schemas.MissionPage.model_validate({"items": items, "next": more})


@router.get("/{mission_id}", summary="Look at a mission")
def get_mission(services: Wired, mission_id: MissionId, version: Version = None) -> schemas.MissionDetail:
    """Its status, progress, document, and what it can be fetched as."""
    with shared.domain_errors():
        record = services.store.missions.get(mission_id, version)
        document = services.store.missions.document(mission_id, record.version)
        body = {**summary(record), "mission": document, "formats": FORMATS}
    return schemas.MissionDetail.model_validate(body)


@router.post(
    "/{mission_id}/versions",
    summary="Send a new version of a mission",
    status_code=201,
    responses=_CREATED,
    openapi_extra=_BODY,
)
def create_version(services: Wired, mission_id: MissionId, body: RawBody, key: IdempotencyKey = None) -> Response:
    """As a new mission, under the same id; earlier versions and their plans stay."""
    with shared.domain_errors():
        settings = services.settings
        services.store.missions.get(mission_id)
        mission = parse_mission_json(body, max_bytes=settings.max_document_bytes, max_stations=settings.max_stations)
        record, is_new = services.store.missions.add_version(
            mission_id,
            write_mission(mission),
            idempotency=shared.idempotency(f"POST /v1/missions/{mission_id}/versions", key, body),
            max_queued=settings.max_queued_missions,
        )
        return _created(services, record, is_new)


@router.get("/{mission_id}/versions", summary="List a mission's versions")
def list_versions(services: Wired, mission_id: MissionId) -> schemas.VersionList:
    """Oldest first."""
    with shared.domain_errors():
        items = [summary(record) for record in services.store.missions.versions(mission_id)]
    return schemas.VersionList.model_validate({"items": items})


@router.delete("/{mission_id}", summary="Put a mission away", status_code=204, response_class=Response)
def archive(services: Wired, mission_id: MissionId) -> Response:
    """It leaves the list and is planned no further; what was flown of it stays on record. Twice does no harm."""
    with shared.domain_errors():
        record = services.store.missions.get(mission_id)
        if record.archived_utc is None and record.status not in _DONE:
            services.pool.cancel(mission_id)
        services.store.missions.archive(mission_id)
    services.changes.tell(mission_id)
    return Response(status_code=204)


@router.get(
    "/{mission_id}/events",
    summary="Watch a mission being planned",
    response_class=EventSourceResponse,
    responses={
        200: {
            "description": "Server-sent events named `progress`, each with a mission summary as data; the last one is "
            "named `done`.",
            "content": {"text/event-stream": {"schema": _EVENT}},
        }
    },
)
async def events(
    services: Wired,
    mission_id: MissionId,
    version: Version = None,
    last_event_id: Annotated[str | None, Header(description="Sent by browsers that connect again.")] = None,
) -> Response:
    """Each change of status or progress as it happens, from the present one to the end of planning."""

    def look() -> dict[str, Any]:
        with shared.domain_errors():
            return summary(services.store.missions.get(mission_id, version))

    first = await run_in_threadpool(look)

    async def stream() -> AsyncIterator[ServerSentEvent]:
        state, told = first, last_event_id
        with services.changes.watch(mission_id) as changed:
            while True:
                changed.clear()
                done = state["status"] in _DONE
                if state["changed_utc"] != told or done:
                    told = state["changed_utc"]
                    yield ServerSentEvent(
                        data=json.dumps(state, allow_nan=False), event="done" if done else "progress", id=told
                    )
                if done:
                    return
                try:
                    async with asyncio.timeout(_POLL_S):
                        await changed.wait()
                except TimeoutError:
                    pass
                state = await run_in_threadpool(look)

    return EventSourceResponse(stream(), ping=15)
