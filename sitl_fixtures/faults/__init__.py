"""Faults injected on purpose: the table, and the injection."""

from __future__ import annotations

from sitl_fixtures.faults.injection import FaultSet, listing
from sitl_fixtures.faults.table import FAULTS

__all__ = ["FAULTS", "FaultSet", "listing"]
