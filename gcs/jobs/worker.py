"""A planning process: takes missions from its parent over a socket, one at a time, and sends back plans.

Messages are JSON, in both directions, in the frames of `multiprocessing.connection` (no pickles). To the worker:
``{"task", "mission", "method", "time_limit_s", "notes"}``, or ``"replan"`` (`gcs.planning.replanning.ReplanOrder`) in
place of ``"mission"``; its answer's ``"plan"`` is a `gcs.planning.replanning.Replanned`. From it: ``{"ready"}`` once,
when everything is imported and has planned once; then for a task any number of ``{"task", "phase", "fraction"}`` and
one of ``{"task", "plan"}``, ``{"task", "infeasible"}``, ``{"task", "malformed"}``, ``{"task", "failed"}``.

The process ends when its parent does, even in the middle of native code (Linux kills it; elsewhere a thread looks).
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

PR_SET_PDEATHSIG = 1
MAX_MESSAGE_BYTES = 200_000_000
# Whether a mission is too large is asked where it comes in.
MAX_STATIONS = 1_000_000

# Plans once at the start, so that the first real mission finds everything warm.
_FIRST_MISSION: dict[str, Any] = {
    "origin": {"lat_deg": 53.0, "lon_deg": 5.0, "alt_amsl_m": 0.0},
    "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 100.0},
    "destination": {"east_m": 3000.0, "north_m": 0.0, "up_m": 100.0},
    "stations": [
        {"id": "a", "east_m": 0.0, "north_m": 0.0, "up_m": 0.0, "range_m": 2000.0},
        {"id": "b", "east_m": 3000.0, "north_m": 0.0, "up_m": 0.0, "range_m": 2000.0},
    ],
    "limits": {"min_alt_amsl_m": 90.0, "max_alt_amsl_m": 120.0, "max_speed_m_s": 20.0, "max_accel_m_s2": 2.0},
}


def main() -> None:
    """Entry: arguments are the socket's descriptor and the parent's process id."""
    descriptor, parent = int(sys.argv[-2]), int(sys.argv[-1])
    _end_with(parent)
    # Ctrl-C is the parent's business. And flights go before planning, on a busy machine.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(5)
    with contextlib.suppress(EOFError, ConnectionError, BrokenPipeError), Connection(descriptor) as channel:
        serve(channel)


def _end_with(parent: int) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)

    def look() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    if os.getppid() != parent:
        os._exit(1)
    threading.Thread(target=look, daemon=True).start()


def serve(channel: Connection[Any, Any]) -> None:
    """Plan what comes over ``channel`` until it closes (`EOFError`)."""
    answer(channel, {"task": None, "mission": _FIRST_MISSION})
    _send(channel, {"ready": True})
    while True:
        answer(channel, json.loads(channel.recv_bytes(MAX_MESSAGE_BYTES)))


def answer(channel: Connection[Any, Any], task: dict[str, Any]) -> None:
    """Plan one task and send what came of it; a task without a number is planned and nothing sent."""
    from gcs.errors import MissionError, MissionInfeasible
    from gcs.mission.document import read_mission
    from gcs.planning.mission_planning import plan_mission
    from gcs.planning.replanning import ReplanOrder

    number = task["task"]

    def tell(phase: str, fraction: float) -> None:
        if number is not None:
            _send(channel, {"task": number, "phase": phase, "fraction": fraction})

    try:
        how = {
            "method": task.get("method"),
            "time_limit_s": task.get("time_limit_s"),
            "notes": task.get("notes", ()),
            "progress": tell,
        }
        if task.get("replan") is not None:
            result: dict[str, Any] = {"plan": ReplanOrder(**task["replan"]).execute(**how).to_document()}
        else:
            mission = read_mission(task["mission"], max_stations=MAX_STATIONS)
            result = {"plan": plan_mission(mission, **how).to_document()}
    except MissionInfeasible as error:
        result = {"infeasible": error.to_document()}
    except MissionError as error:
        result = {"malformed": error.to_document()}
    except (EOFError, ConnectionError):
        raise
    except Exception as error:  # whatever it is, the mission failed and the next one is tried
        result = {"failed": f"{type(error).__name__}: {error}"}
    if number is not None:
        _send(channel, {"task": number, **result})


def _send(channel: Connection[Any, Any], message: dict[str, Any]) -> None:
    channel.send_bytes(json.dumps(message, allow_nan=False).encode())


if __name__ == "__main__":
    main()
