"""What routes are given: the services of the application a request came to."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends
from starlette.requests import HTTPConnection

from api.service import Services


def services_of(connection: HTTPConnection) -> Services:
    """The services of the application a request came to."""
    found = connection.app.state.services
    assert isinstance(found, Services)
    return found


Wired = Annotated[Services, Depends(services_of)]
