"""What runs in a planning process: it is made ready once, then plans one task after another.

A task is ``{"number", "mission", "method", "notes"}``, or ``"replan"`` (`gcs.planning.replanning.ReplanOrder`) in place
of ``"mission"``; its answer one of ``{"plan"}`` (of a replan a `gcs.planning.replanning.Replanned`), ``{"infeasible"}``,
``{"malformed"}``, ``{"failed"}``. How far it is goes over a pipe that all processes write to: lines of JSON, each
shorter than what a pipe takes whole.

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

from gcs.errors import MissionError, MissionInfeasible
from gcs.mission.document import read_mission
from gcs.planning.mission_planning import plan_mission
from gcs.planning.replanning import ReplanOrder

PR_SET_PDEATHSIG = 1
# Whether a mission is too large is asked where it comes in.
MAX_STATIONS = 1_000_000
_LONGEST_LINE_BYTES = 512

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
_telling: Connection[Any, Any] | None = None


def prepare(parent: int, niceness: int, telling: Connection[Any, Any]) -> None:
    """Tie the process to its ``parent``, and plan once; ``telling`` is the pipe's end for progress."""
    global _telling
    _end_with(parent)
    # Flights go before planning, on a busy machine.
    with contextlib.suppress(OSError):
        os.nice(niceness)
    with open(os.devnull, "r+b") as nothing:
        for descriptor in (0, 1):
            os.dup2(nothing.fileno(), descriptor)
    os.set_blocking(telling.fileno(), False)
    _telling = telling
    plan({"number": None, "mission": _FIRST_MISSION})


def process_id() -> int:
    """Answers once the process is ready."""
    return os.getpid()


def plan(task: dict[str, Any]) -> dict[str, Any]:
    """Plan one task; what came of it. A task without a number tells no progress."""
    number = task["number"]

    def tell(phase: str, fraction: float) -> None:
        if number is not None:
            _tell(number, phase, fraction)

    how = {"method": task.get("method"), "notes": task.get("notes", ()), "progress": tell}
    try:
        if task.get("replan") is not None:
            return {"plan": ReplanOrder(**task["replan"]).execute(**how).to_document()}
        mission = read_mission(task["mission"], max_stations=MAX_STATIONS)
        return {"plan": plan_mission(mission, **how).to_document()}
    except MissionInfeasible as error:
        return {"infeasible": error.to_document()}
    except MissionError as error:
        return {"malformed": error.to_document()}
    except Exception as error:  # whatever it is, the mission failed and the next one is tried
        return {"failed": f"{type(error).__name__}: {error}"}


def _tell(number: int, phase: str, fraction: float) -> None:
    line = json.dumps([number, phase, fraction], allow_nan=False).encode() + b"\n"
    if _telling is not None and len(line) <= _LONGEST_LINE_BYTES:
        with contextlib.suppress(OSError):  # nobody reads just now: progress may be missed, plans not
            os.write(_telling.fileno(), line)


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
