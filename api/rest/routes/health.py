"""Liveness, readiness, metrics, and the service's own description."""

from __future__ import annotations

from typing import Any

import anyio.to_thread
from fastapi import APIRouter, Request
from starlette.responses import JSONResponse, Response

from api.rest.dependencies import Wired
from api.rest.problems import UnavailableError
from api.rest.schemas.base import Health
from gcs.errors import StoreUnavailable
from gcs.planning import product_version

router = APIRouter(tags=["service"])


@router.get("/healthz", summary="Is it alive?")
async def healthz() -> Health:
    """Answers as long as the process does; asks nothing else, and waits for no thread."""
    return Health(status="ok", version=product_version(), checks={})


@router.get("/readyz", summary="Can it work?")
async def readyz(services: Wired) -> Health:
    """The store takes a write and a planner is warm; 503 with what is missing otherwise."""
    checks = {"store": "ok", "planner": "ok"}
    try:
        # On a thread of its own: it must not wait for one behind what it is asked about.
        await anyio.to_thread.run_sync(services.store.check, limiter=services.probes)
    except StoreUnavailable as error:
        checks["store"] = str(error)
    if not services.pool.ready:
        checks["planner"] = "warming up"
    missing = {name: text for name, text in checks.items() if text != "ok"}
    if missing:
        detail = "; ".join(f"{name}: {text}" for name, text in missing.items())
        raise UnavailableError(detail, kind="not-ready", title="Not ready", checks=checks)
    return Health(status="ready", version=product_version(), checks=checks)


@router.get(
    "/metrics",
    summary="Figures for Prometheus",
    response_class=Response,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Text exposition."}},
)
def metrics(services: Wired) -> Response:
    """Missions by status, planning times, requests, process."""
    return Response(services.metrics.text(), headers={"content-type": services.metrics.content_type})


@router.get("/openapi.json", include_in_schema=False)
def openapi(request: Request) -> Response:
    """The OpenAPI document."""
    described: dict[str, Any] = request.app.openapi()
    return JSONResponse(described)
