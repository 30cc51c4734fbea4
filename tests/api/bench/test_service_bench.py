"""The service's bench: figures of a real service, with and without a history."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from api.bench import service
from api.processes import QUICK_MISSION


@pytest.mark.slow
def test_every_kind_of_request_is_measured_over_the_history_asked_for(tmp_path: Path) -> None:
    figures = service.measure(tmp_path / "data", json.dumps(QUICK_MISSION).encode(), requests=8, history=450)
    by_name = {figure.name: figure for figure in figures}
    assert by_name["all pages of 200"].requests == 3  # 451 missions
    assert all(0.0 < figure.p50_ms <= figure.p99_ms for figure in figures)
