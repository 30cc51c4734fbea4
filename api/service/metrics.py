"""What ``/metrics`` shows, in a registry of the application's own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from datetime import datetime

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    disable_created_metrics,
)
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.exposition import CONTENT_TYPE_LATEST, generate_latest
from prometheus_client.registry import Collector

# When each counter began is of no use here, and doubles the series.
disable_created_metrics()  # type: ignore[no-untyped-call]

_PLANNING_BUCKETS_S = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0, 60.0)
_REQUEST_BUCKETS_S = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class _Counts(Collector):
    """Numbers of things by status, asked for when somebody looks."""

    def __init__(self, name: str, text: str, count: Callable[[], Mapping[str, int]]) -> None:
        self._name, self._text, self._count = name, text, count

    def describe(self) -> Iterator[GaugeMetricFamily]:
        """The family without samples: registering must not ask the store."""
        yield GaugeMetricFamily(self._name, self._text, labels=["status"])

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """One sample for each status."""
        family = GaugeMetricFamily(self._name, self._text, labels=["status"])
        for status, number in sorted(self._count().items()):
            family.add_metric([status], number)
        yield family


class Metrics:
    """The service's counters and histograms."""

    content_type = CONTENT_TYPE_LATEST

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        ProcessCollector(registry=self.registry)
        PlatformCollector(registry=self.registry)
        self.requests = Counter(
            "skyrelay_http_requests", "HTTP requests answered", ["method", "route", "status"], registry=self.registry
        )
        self.request_seconds = Histogram(
            "skyrelay_http_request_seconds",
            "Time from a request to the end of its answer",
            ["route"],
            buckets=_REQUEST_BUCKETS_S,
            registry=self.registry,
        )
        self.planning_seconds = Histogram(
            "skyrelay_planning_seconds",
            "Time from a mission's acceptance to its plan, or to knowing there is none; waiting included",
            ["outcome"],
            buckets=_PLANNING_BUCKETS_S,
            registry=self.registry,
        )

    def observe_request(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one answered request under its route's template (not its path: ids would make endless series)."""
        known = method if method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS") else "OTHER"
        self.requests.labels(known, route, str(status)).inc()
        self.request_seconds.labels(route).observe(seconds)

    def observe_planning(self, outcome: str, from_utc: str, to_utc: str) -> None:
        """Count one finished planning, from when it was asked for to when it was known (RFC 3339 times)."""
        seconds = (datetime.fromisoformat(to_utc) - datetime.fromisoformat(from_utc)).total_seconds()
        self.planning_seconds.labels(outcome).observe(max(0.0, seconds))

    def watch_counts(self, name: str, text: str, count: Callable[[], Mapping[str, int]]) -> None:
        """Add a gauge by status whose numbers ``count`` gives at the time of asking."""
        self.registry.register(_Counts(name, text, count))

    def text(self) -> bytes:
        """The exposition in Prometheus' text format."""
        return generate_latest(self.registry)
