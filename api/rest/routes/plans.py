"""What a mission's plan can be fetched as: the document, the handover schedule, the setpoint stream."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Any, Literal, get_args

from fastapi import APIRouter, Query
from starlette.responses import JSONResponse, Response, StreamingResponse

from api.rest.dependencies import Wired
from api.rest.problems import ConflictError, UnprocessableError
from api.rest.routes import missions, shared
from api.rest.routes.shared import MissionId, Version
from api.service import Services
from gcs.exports import FORMATS as HANDOVER_FORMATS
from gcs.exports import export_handovers, parse_launch
from gcs.store import MissionRecord
from link.files import FORMATS as SETPOINT_FORMATS
from link.files import Format, setpoint_file
from link.setpoints import RATE_LIMITS_HZ

router = APIRouter(prefix="/v1/missions/{mission_id}", tags=["plans"])

_MEDIA = {
    "table": "text/plain; charset=utf-8",
    "json": "application/json",
    "csv": "text/csv; charset=utf-8",
    "jsonl": "application/x-ndjson",
    "tlog": "application/octet-stream",
}
_SUFFIX = {"table": "txt"}
_LAUNCH = Query(
    description="UTC of T+0, RFC 3339 with a time zone; times are then given in UTC too.",
    examples=["2026-11-22T09:00:00Z"],
    max_length=64,
)
# An offset's plus sign turns into a blank in an address that was not quoted.
_LOST_PLUS = re.compile(r" (?=\d\d:?\d\d$)")


def planned(services: Services, mission_id: str, version: int | None) -> MissionRecord:
    """A version that has a plan. Raises `ConflictError` with status, reason, place, gap_m and fix where it has none."""
    record = services.store.missions.get(mission_id, version)
    if record.status == "planned":
        return record
    problem = missions.problem_of(record)
    if problem is None:
        raise ConflictError(
            f"the mission is {record.status}; it has no plan yet",
            kind="not-planned",
            mission_status=record.status,
            progress={"phase": record.phase, "fraction": record.progress},
        )
    title, detail = problem.pop("title"), problem.pop("detail")
    kind = "infeasible" if record.status == "infeasible" else "planning-failed"
    raise ConflictError(detail, kind=kind, title=title, mission_status=record.status, **problem)


def launch_time(text: str | None) -> datetime | None:
    """A launch time from a query. Raises `ExportError`."""
    return None if text is None else parse_launch(_LOST_PLUS.sub("+", text))


def _attachment(record: MissionRecord, what: str, form: str) -> dict[str, str]:
    name = f"{what}-{record.id[:8]}-v{record.version}.{_SUFFIX.get(form, form)}"
    return {"Content-Disposition": f'inline; filename="{name}"', "X-Plan-SHA256": record.plan_sha256 or ""}


def _content(*forms: str) -> dict[int | str, dict[str, Any]]:
    content: dict[str, Any] = {}
    for form in forms:
        media = _MEDIA[form].split(";")[0]
        content[media] = {"schema": {} if media == "application/json" else {"type": "string"}}
    return {200: {"content": content, "description": "In the form asked for."}}


@router.get(
    "/plan",
    summary="Fetch the plan",
    responses={200: {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/PlanBody"}}}}},
)
def plan(services: Wired, mission_id: MissionId, version: Version = None) -> Response:
    """The plan document, self-contained; 409 while there is none, with reason and fix when there can be none."""
    with shared.domain_errors():
        record = planned(services, mission_id, version)
        document = services.store.missions.plan(mission_id, record.version)
    headers = {**_attachment(record, "plan", "json"), "ETag": f'"{record.plan_sha256}"'}
    return JSONResponse(document, headers=headers)


@router.get("/handovers", summary="Fetch the handover schedule", responses=_content(*HANDOVER_FORMATS))
def handovers(
    services: Wired,
    mission_id: MissionId,
    form: Annotated[str, Query(alias="format", json_schema_extra={"enum": list(HANDOVER_FORMATS)})] = "json",
    station: Annotated[
        str | None, Query(max_length=64, description="Only the handovers this station transfers or receives.")
    ] = None,
    launch: Annotated[str | None, _LAUNCH] = None,
    version: Version = None,
) -> Response:
    """When, where, the transferring and the receiving station, how long both cover the vehicle; whole or one's part."""
    shared.one_of("format", form, HANDOVER_FORMATS)
    with shared.domain_errors():
        at = launch_time(launch)
        record = planned(services, mission_id, version)
        text = export_handovers(services.plan_of(record), form, station=station, launch=at)
    headers = {**_attachment(record, "handovers", form), "content-type": _MEDIA[form]}
    return Response(text, headers=headers)


@router.get("/setpoints", summary="Fetch the setpoint stream", responses=_content(*SETPOINT_FORMATS))
def setpoints(
    services: Wired,
    mission_id: MissionId,
    rate: Annotated[float, Query(ge=RATE_LIMITS_HZ[0], le=RATE_LIMITS_HZ[1], description="Samples a second.")] = 20.0,
    form: Annotated[str, Query(alias="format", json_schema_extra={"enum": list(SETPOINT_FORMATS)})] = "csv",
    autopilot: Annotated[Literal["px4", "ardupilot"], Query(description="Whose message a tlog holds.")] = "px4",
    launch: Annotated[str | None, _LAUNCH] = None,
    version: Version = None,
) -> Response:
    """The plan resampled, sent as it is made: it is never whole in memory, however long the flight."""
    shared.one_of("format", form, SETPOINT_FORMATS)
    with shared.domain_errors():
        at = launch_time(launch)
        record = planned(services, mission_id, version)
        chosen: Format = next(f for f in get_args(Format) if f == form)
        try:
            pieces = setpoint_file(services.plan_of(record), rate, chosen, autopilot=autopilot, launch=at)
        except ValueError as error:
            raise UnprocessableError(str(error)) from None
    headers = {**_attachment(record, "setpoints", form), "content-type": _MEDIA[form]}
    # A plain iterator: Starlette takes each piece on a thread, so that the loop stays free for others.
    return StreamingResponse(pieces, headers=headers)
