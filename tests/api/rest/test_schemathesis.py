"""The service held against its own description: whatever the description allows must not bring it down."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.processes.cli_process import Server
from tests.support.processes.store_backends import Backend

CHECKS = "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance"


def hold_against_the_description(tmp_path: Path, phases: str, examples: int) -> None:
    server = Server(tmp_path / "data", "--log-level", "error")
    try:
        done = subprocess.run(
            [
                str(Path(sys.executable).parent / "schemathesis"),
                "run",
                f"{server.address}/openapi.json",
                f"--phases={phases}",
                f"--max-examples={examples}",
                f"--checks={CHECKS}",
                "--seed=1",
                "--suppress-health-check=all",
                "--request-timeout=20",
                "--no-color",
                "--generation-database=none",
            ],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            check=False,
        )
        assert done.returncode == 0, done.stdout[-6000:] + done.stderr[-2000:]
        assert "Traceback" not in server.said()
    finally:
        server.stop()


@pytest.mark.slow
def test_no_request_the_description_allows_causes_a_fault(
    tmp_path: Path, backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYRELAY_DATABASE_URL", backend.url)
    hold_against_the_description(tmp_path, "examples,fuzzing", 10)


@pytest.mark.soak
def test_no_request_at_any_bound_of_the_description_causes_a_fault(
    tmp_path: Path, backend: Backend, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYRELAY_DATABASE_URL", backend.url)
    hold_against_the_description(tmp_path, "examples,coverage,fuzzing", 200)
