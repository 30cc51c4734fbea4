"""REST: the application, what every request passes, problem details, routes and their bodies."""

from __future__ import annotations

from api.rest.app import create_app
from api.rest.connections import BACKLOG, Limits, connection_class, possible_connections

__all__ = ["BACKLOG", "Limits", "connection_class", "create_app", "possible_connections"]
