"""The application: wires settings, store, planning jobs, flights, routes and middleware. Nothing is decided here."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import FastAPI

from api.rest import problems
from api.rest.guards import HostGuard, OriginGuard
from api.rest.middleware import BodyLimit, HeadAnswers, RequestLog
from api.rest.openapi import describe
from api.rest.routes import flights, health, missions, page, plans, registries
from api.service import Metrics, Services
from gcs.planning import product_version
from gcs.settings import Settings


def create_app(settings: Settings) -> FastAPI:
    """The service. Its store is opened and its planners are started with the application, not before."""
    metrics = Metrics()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with Services.open(settings, metrics) as services:
            app.state.services = services
            yield

    app = FastAPI(
        title="skyrelay",
        version=product_version(),
        lifespan=lifespan,
        openapi_url=None,  # served by `health`, with problem documents described on every operation
        docs_url=None,  # FastAPI's own pages load scripts from elsewhere
        redoc_url=None,
        strict_content_type=False,  # `bodies` judges it, for every route alike
    )
    routers = [module.router for module in (missions, plans, registries, flights, health, page)]
    page.mount(app)
    for router in routers:
        app.include_router(router)
    problems.install(app, [route for router in routers for route in router.routes])
    describe(app)
    # The last one added is the outermost.
    app.add_middleware(BodyLimit, limit_bytes=settings.max_body_bytes, mission_bytes=settings.max_document_bytes)
    app.add_middleware(HeadAnswers)
    app.add_middleware(OriginGuard)
    app.add_middleware(HostGuard, names=settings.allowed_hosts)
    app.add_middleware(RequestLog, observe=metrics.observe_request)
    return app
