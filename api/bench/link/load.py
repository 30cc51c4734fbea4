"""Full load beside a flight: ``python -m api.bench.link.load planner`` plans without pause, ``... api URL`` asks a
service.

Each runs until it is ended. The asker sends new missions to be planned, and fetches lists and whole setpoint streams in
between: the answers that once held up a flight for seconds.
"""

from __future__ import annotations

import contextlib
import json
import sys
import urllib.error
import urllib.request
from typing import Any

from api.processes import QUICK_MISSION


def plan_for_ever() -> None:
    """Plan the same small mission again and again."""
    from gcs.mission import read_mission
    from gcs.planning import plan_mission

    while True:
        plan_mission(read_mission(QUICK_MISSION))


def ask_for_ever(url: str) -> None:
    """Send missions and read what there is, one request after another."""
    count = 0
    while True:
        count += 1
        with contextlib.suppress(OSError, ValueError, KeyError):
            body = {**QUICK_MISSION, "name": f"load {count}"}
            mission = _ask(f"{url}/v1/missions", body)
            for _ in range(5):
                _ask(f"{url}/v1/missions?limit=100")
                _ask(f"{url}/v1/missions/{mission['id']}")
                with contextlib.suppress(urllib.error.HTTPError):  # not planned yet
                    _ask(f"{url}/v1/missions/{mission['id']}/setpoints?format=json&rate_hz=50")


def _ask(url: str, body: dict[str, Any] | None = None) -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=60.0) as answer:
        return json.loads(answer.read())


if __name__ == "__main__":
    if sys.argv[1] == "planner":
        plan_for_ever()
    else:
        ask_for_ever(sys.argv[2])
