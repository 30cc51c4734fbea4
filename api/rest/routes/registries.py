"""``/v1/stations``, ``/v1/vehicles``, ``/v1/links``: things known by name, which flights refer to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Header, Path, Query
from pydantic import BaseModel
from starlette.responses import JSONResponse, Response

from api.rest import schemas
from api.rest.bodies import StrictRoute
from api.rest.dependencies import Wired
from api.rest.problems import NotFoundError, UnprocessableError, domain_faults
from api.rest.routes import shared
from api.rest.routes.shared import Limit
from api.service import Services, restore_vehicle
from gcs.mission import station_faults
from gcs.store import Entry
from link.errors import EndpointUrlError
from link.transport import parse_url

router = APIRouter(prefix="/v1", tags=["registries"], route_class=StrictRoute)

EntryId = Annotated[
    str,
    Path(
        max_length=64,
        pattern=schemas.ENTRY_ID,
        description="Its name: letters, digits, blanks and . _ - : + # ( ) ' &, beginning with a letter or digit.",
        examples=["den-helder"],
    ),
]
After = Annotated[
    str | None,
    Query(max_length=64, pattern=schemas.ENTRY_ID, alias="cursor", description="`next` of the page before."),
]
IfMatch = Annotated[
    str | None,
    Header(
        alias="If-Match",
        pattern=r'^"?[0-9]{1,9}"?$',
        description="Revision that is to be replaced (0: there must be none); refused when another stands there.",
    ),
]


def _shown(entry: Entry) -> dict[str, Any]:
    return {
        "id": entry.id,
        **entry.document,
        "revision": entry.revision,
        "created_utc": entry.created_utc,
        "changed_utc": entry.changed_utc,
    }


def _put(services: Services, kind: str, entry_id: str, body: BaseModel, if_match: str | None) -> Response:
    document = body.model_dump(exclude_none=True)
    revision = None if if_match is None else int(if_match.strip('"'))
    with shared.domain_errors():
        entry, is_new = services.store.registry.put(kind, entry_id, document, revision=revision)
    return JSONResponse(_shown(entry), status_code=201 if is_new else 200, headers={"ETag": f'"{entry.revision}"'})


def _page(services: Services, kind: str, limit: int, after: str | None) -> dict[str, Any]:
    with shared.domain_errors():
        entries = services.store.registry.page(kind, limit=limit + 1, after=after)
    more = entries[limit - 1].id if len(entries) > limit else None
    return {"items": [_shown(e) for e in entries[:limit]], "next": more}


def _check_station(body: schemas.RegisteredStation, _services: Services) -> None:
    """By the rules of a mission, into which it is to be put."""
    found = station_faults({"id": "station", **body.model_dump(exclude_none=True)})
    if found:
        errors = [{**fault, "where": f"body.{fault['where']}"} for fault in domain_faults(found)]
        raise UnprocessableError(f"{errors[0]['where']}: {errors[0]['what']}", errors=errors)


def _check_link(body: schemas.RegisteredLink, _services: Services) -> None:
    try:
        parse_url(body.url)
    except EndpointUrlError as error:
        raise UnprocessableError(
            str(error),
            errors=[
                {
                    "where": "body.url",
                    "what": "is not a link address",
                    "value": body.url,
                    "allowed": "udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD",
                    "fix": "e.g. udpout:127.0.0.1:14540",
                }
            ],
        ) from None


def _check_vehicle(body: schemas.RegisteredVehicle, services: Services) -> None:
    missing: list[dict[str, Any]] = []
    for station, link in body.links.items():
        try:
            with shared.domain_errors():
                services.store.registry.get("link", link)
        except NotFoundError:
            missing.append(
                {
                    "where": f"body.links.{station}",
                    "what": "names a link nobody registered",
                    "value": link,
                    "fix": f"PUT /v1/links/{link} first",
                }
            )
    if missing:
        raise UnprocessableError("the vehicle names links nobody registered", errors=missing)


@dataclass(frozen=True)
class _Registry:
    """What differs from one registry to another; ``check`` raises `UnprocessableError` beyond what the model asks."""

    kind: str
    plural: str
    model: type[BaseModel]
    entry: type[BaseModel]
    check: Callable[[Any, Services], None]
    what: str


def _add_reading(of: _Registry) -> None:
    def page(services: Wired, limit: Limit = 50, after: After = None) -> schemas.RegistryPage:
        return schemas.RegistryPage.model_validate(_page(services, of.kind, limit, after))

    def get(services: Wired, entry_id: EntryId) -> Response:
        with shared.domain_errors():
            found = services.store.registry.get(of.kind, entry_id)
        return JSONResponse(_shown(found), headers={"ETag": f'"{found.revision}"'})

    router.add_api_route(
        f"/{of.plural}",
        page,
        methods=["GET"],
        summary=f"List {of.plural}",
        name=f"list_{of.plural}",
        description=of.what,
    )
    router.add_api_route(
        f"/{of.plural}/{{entry_id}}",
        get,
        methods=["GET"],
        summary=f"Look at a {of.kind}",
        name=f"get_{of.kind}",
        description=of.what,
        responses={200: {"model": of.entry}},
        response_model=None,
    )


def _add_writing(of: _Registry) -> None:
    def put(services: Wired, entry_id: EntryId, body: Any, if_match: IfMatch = None) -> Response:
        of.check(body, services)
        return _put(services, of.kind, entry_id, body, if_match)

    # FastAPI reads the body's type from here; it differs from kind to kind.
    put.__annotations__["body"] = of.model

    def remove(services: Wired, entry_id: EntryId) -> Response:
        with shared.domain_errors():
            services.store.registry.remove(of.kind, entry_id)
        return Response(status_code=204)

    router.add_api_route(
        f"/{of.plural}/{{entry_id}}",
        put,
        methods=["PUT"],
        summary=f"Add or replace a {of.kind}",
        name=f"put_{of.kind}",
        description=of.what,
        responses={
            200: {"model": of.entry, "description": "Replaced."},
            201: {"model": of.entry, "description": "Added."},
        },
        response_model=None,
    )
    router.add_api_route(
        f"/{of.plural}/{{entry_id}}",
        remove,
        methods=["DELETE"],
        summary=f"Forget a {of.kind}",
        name=f"remove_{of.kind}",
        description=of.what,
        status_code=204,
        response_class=Response,
    )


_REGISTRIES = (
    _Registry(
        "station",
        "stations",
        schemas.RegisteredStation,
        schemas.StationEntry,
        _check_station,
        "A ground station (remote pilot station): place, range, crew. For missions to be put together from.",
    ),
    _Registry(
        "vehicle",
        "vehicles",
        schemas.RegisteredVehicle,
        schemas.VehicleEntry,
        _check_vehicle,
        "A vehicle: its autopilot, and each station's C2 link to it.",
    ),
    _Registry(
        "link",
        "links",
        schemas.RegisteredLink,
        schemas.LinkEntry,
        _check_link,
        "A C2 link: where a station's radio is reached. Named here so that flights need not know addresses.",
    ),
)
for _registry in _REGISTRIES:
    _add_reading(_registry)
    _add_writing(_registry)


@router.post("/vehicles/{entry_id}/restore", summary="Give back what flights left changed on a vehicle")
def restore(services: Wired, entry_id: EntryId, body: schemas.RestoreRequest | None = None) -> schemas.Restored:
    """From the journal of this machine: GCS ids, rally points, geofence; on the ground, disarmed, and not in flight."""
    asked = body or schemas.RestoreRequest(unlock=False)
    with shared.domain_errors():
        done = restore_vehicle(services.store, entry_id, unlock=asked.unlock)
    return schemas.Restored.model_validate(done)
