"""What every test shares: reproducible property tests, and skips that fail where everything is required."""

from __future__ import annotations

import os
import tempfile
import uuid
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from tests.support.processes import postgresql
from tests.support.processes.store_backends import Backend

settings.register_profile(
    "skyrelay",
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("skyrelay")

# What flights note for whoever comes next stays in the run, and processes of the run find it.
os.environ.setdefault("SKYRELAY_STATE_DIR", tempfile.mkdtemp(prefix="skyrelay-state-"))

REQUIRE_ALL = os.environ.get("REQUIRE_ALL") == "1"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first: a flight in real time at the end would leave the other processes idle."""

    def shortness(item: pytest.Item) -> tuple[bool, float]:
        allowed = item.get_closest_marker("timeout")
        return item.get_closest_marker("slow") is None, -float(allowed.args[0] if allowed else 0.0)

    items.sort(key=shortness)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, None]:  # type: ignore[type-arg]
    """With ``REQUIRE_ALL=1`` a skipped test is a failure: nothing may be missing where everything is checked."""
    outcome = yield
    report = outcome.get_result()  # type: ignore[attr-defined]
    if REQUIRE_ALL and report.skipped and not hasattr(report, "wasxfail"):
        report.outcome = "failed"
        report.longrepr = f"{item.nodeid} was skipped, but REQUIRE_ALL=1: {report.longrepr}"


@pytest.fixture(scope="session")
def postgresql_server() -> Iterator[postgresql.PostgreSql]:
    """A PostgreSQL server, started once for the tests of this process; a skip where there is none."""
    if postgresql.programs() is None:
        pytest.skip(postgresql.MISSING)
    with postgresql.running() as server:
        yield server


@pytest.fixture(params=["sqlite", "postgresql"])
def backend(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Backend]:
    """A new, empty database; each test that asks for one runs on both kinds."""
    if request.param == "sqlite":
        yield Backend("sqlite", f"sqlite:///{tmp_path / 'skyrelay.db'}")
        return
    server: postgresql.PostgreSql = request.getfixturevalue("postgresql_server")
    with server.database(f"t{uuid.uuid4().hex}") as url:
        yield Backend("postgresql", url)
