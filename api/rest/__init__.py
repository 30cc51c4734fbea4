"""REST: the application, what every request passes, problem details, routes and their bodies."""

from __future__ import annotations

from api.rest.app import create_app

__all__ = ["create_app"]
