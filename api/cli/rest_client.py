"""The service as a program sees it: its REST interface, for the commands that speak to one that runs."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Any

from api.cli.errors import FaultError


class ServiceClient:
    """The REST interface, as any program would use it."""

    def __init__(self, address: str) -> None:
        self.address = address

    def call(self, method: str, path: str, body: Any = None) -> Any:
        """The answer's JSON. Raises `FaultError` with the problem's detail where the service refuses."""
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            self.address + path, data=data, method=method, headers={"Content-Type": "application/json"}
        )
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                return json.loads(answer.read() or b"null")
        except urllib.error.HTTPError as error:
            problem = json.loads(error.read() or b"{}")
            raise RefusedError(method, path, error.code, problem) from None
        except OSError as error:
            raise FaultError(
                "the service does not answer", {"where": self.address + path, "what": str(error)}
            ) from None

    def ready(self) -> bool:
        """Whether the service can work."""
        try:
            self.call("GET", "readyz")
        except FaultError:
            return False
        return True


class RefusedError(FaultError):
    """The service answered with a problem; ``status`` and ``problem`` are its."""

    def __init__(self, method: str, path: str, status: int, problem: dict[str, Any]) -> None:
        super().__init__(
            f"the service refused {method} /{path}", {"what": problem.get("detail"), "status": str(status)}
        )
        self.status = status
        self.problem = problem
