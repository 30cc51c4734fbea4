"""The simulator as a process, and a lossy proxy (``python -m sitl_fixtures.process.proxy``)."""

from __future__ import annotations

from sitl_fixtures.process.host import Address, run_process
from sitl_fixtures.process.lossy_channel import Impairment, LossyChannel

__all__ = ["Address", "Impairment", "LossyChannel", "run_process"]
