"""The OpenAPI document: FastAPI's, with missions, plans and problem documents described as they are."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic import BaseModel

from api.rest import schemas

DESCRIPTION = """
Missions for flights that must keep a C2 link to a ground station (remote pilot station) all the way, handed over from
station to station.

Send a mission, watch it being planned, fetch the plan, the handover schedule and the setpoints, fly it.
SI units; degrees for latitude, longitude and course; every altitude says its reference. Every error is an RFC 9457
problem document whose `errors` say where, what, what is allowed and what to do.
"""
TAGS = [
    {"name": "missions", "description": "What is to be flown, and how its planning stands."},
    {"name": "plans", "description": "What comes of it: the plan, the schedule, the setpoints."},
    {"name": "registries", "description": "Stations, vehicles and C2 links known by name."},
    {"name": "flights", "description": "A plan being flown, and the operators' commands to it."},
    {"name": "service", "description": "The service itself."},
]
# What any operation may answer besides its own, with an example where one helps.
_ERRORS: dict[str, tuple[str, type[BaseModel], Any]] = {
    "403": ("A write from another site, or a host name that is not this service's.", schemas.ProblemDetails, None),
    "404": ("Nothing of that id.", schemas.ProblemDetails, None),
    "409": ("Not possible in the present state.", schemas.ProblemDetails, None),
    "413": ("The body is too large.", schemas.ProblemDetails, None),
    "415": ("The body is not JSON, or does not say so.", schemas.ProblemDetails, None),
    "422": ("Bad input: where, what, what is allowed, what to do.", schemas.ProblemDetails, schemas.BAD_INPUT_EXAMPLE),
    "500": ("A fault of the service.", schemas.ProblemDetails, None),
    "503": ("The store cannot be used just now, or the service is not ready.", schemas.ProblemDetails, None),
}
_METHODS = ("get", "put", "post", "delete", "patch")


def describe(app: FastAPI) -> None:
    """Make ``app.openapi`` build the document once."""

    def build() -> dict[str, Any]:
        if app.openapi_schema is None:
            document = get_openapi(
                title=app.title,
                version=app.version,
                description=DESCRIPTION,
                tags=TAGS,
                routes=app.routes,
                license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
            )
            _complete(document)
            app.openapi_schema = document
        return app.openapi_schema

    app.openapi = build  # type: ignore[method-assign]


def _complete(document: dict[str, Any]) -> None:
    components = document.setdefault("components", {}).setdefault("schemas", {})
    for model in (schemas.MissionBody, schemas.PlanBody, schemas.ProblemDetails, schemas.InfeasibleDetails):
        schema = model.model_json_schema(ref_template="#/components/schemas/{model}")
        components.update(schema.pop("$defs", {}))
        components[model.__name__] = schema
    for path, item in document["paths"].items():
        for method in _METHODS:
            if method in item:
                _add_errors(path, item[method])
    for name in ("HTTPValidationError", "ValidationError"):
        components.pop(name, None)


def _add_errors(path: str, operation: dict[str, Any]) -> None:
    has_id = "{" in path
    takes_body = "requestBody" in operation
    takes_anything = takes_body or has_id or operation.get("parameters")
    answers = operation.setdefault("responses", {})
    for status, (text, model, example) in _ERRORS.items():
        if (status == "404" and not (has_id or takes_body)) or (status in ("413", "415") and not takes_body):
            continue
        if (status == "422" and not takes_anything) or (status == "409" and not (has_id or takes_body)):
            continue
        if status in answers and "application/problem+json" in answers[status].get("content", {}):
            continue
        shown: dict[str, Any] = {"schema": {"$ref": f"#/components/schemas/{model.__name__}"}}
        if example is not None:
            shown["example"] = example
        if status == "409" and path.endswith(("/plan", "/handovers", "/setpoints")):
            shown["schema"] = {"$ref": "#/components/schemas/InfeasibleDetails"}
            shown["example"] = schemas.INFEASIBLE_EXAMPLE
        answers[status] = {"description": text, "content": {"application/problem+json": shown}}
