"""Programs that commands and benchmarks start beside themselves, the simulator above all; and a mission for it."""

from __future__ import annotations

from api.processes.children import Child, ChildError, Children, python_module
from api.processes.quick_mission import QUICK_MISSION
from api.processes.simulator import home_under, start_simulator

__all__ = [
    "QUICK_MISSION",
    "Child",
    "ChildError",
    "Children",
    "home_under",
    "python_module",
    "start_simulator",
]
