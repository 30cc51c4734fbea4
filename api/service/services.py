"""What routes work with: the store, the planning jobs, caches; opened and closed with the application."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import anyio

from api.service.changes import Changes
from api.service.flights import FlightService
from api.service.metrics import Metrics
from api.service.replanning import Replanning
from gcs.errors import StoreUnavailable
from gcs.jobs import PlanningPool
from gcs.plan import Plan, read_plan
from gcs.settings import Settings
from gcs.store import DataOwner, MissionRecord, Store

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Cache(Generic[K, V]):
    """The last ``size`` values asked for; used from several threads. What is made twice at once is made twice."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._lock = threading.Lock()
        self._held: OrderedDict[K, V] = OrderedDict()

    def get(self, key: K, make: Callable[[], V]) -> V:
        """The value of ``key``, made where it is not held."""
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
                return self._held[key]
        value = make()
        with self._lock:
            self._held[key] = value
            while len(self._held) > self._size:
                self._held.popitem(last=False)
        return value


@dataclass
class Services:
    """The parts of a running service."""

    settings: Settings
    metrics: Metrics
    store: Store
    pool: PlanningPool
    changes: Changes
    flights: FlightService
    replanning: Replanning
    probes: anyio.CapacityLimiter = field(default_factory=lambda: anyio.CapacityLimiter(2))
    plans: Cache[str, Plan] = field(default_factory=lambda: Cache(16))

    @classmethod
    @contextlib.contextmanager
    def open(cls, settings: Settings, metrics: Metrics) -> Iterator[Services]:
        """Open the store, start the planners; end them with the block. Raises `StoreUnavailable`, ``OSError``."""
        settings.prepare()
        changes = Changes()
        changes.bind(asyncio.get_running_loop())

        def on_change(record: MissionRecord) -> None:
            changes.tell(record.id)
            if record.status in ("planned", "infeasible", "failed"):
                metrics.observe_planning(record.status, record.created_utc, record.changed_utc)

        with (
            contextlib.closing(DataOwner(settings.data_dir)) as owner,
            Store(settings.url, lock_timeout_s=settings.lock_timeout_s) as store,
        ):
            pool = PlanningPool(
                store,
                processes=settings.planner_processes,
                limit_s=settings.planning_limit_s,
                on_change=on_change,
            )
            flights = FlightService(settings, store, changes, owner.name)
            services = cls(settings, metrics, store, pool, changes, flights, Replanning(flights, pool))
            metrics.watch_counts("skyrelay_missions", "Mission versions by status", services.mission_counts)
            metrics.watch_counts("skyrelay_planners", "Planning processes by state", pool.stats)
            metrics.watch_counts("skyrelay_flights", "Running flights by state", flights.counts)
            pool.start()
            try:
                flights.reattach()
                yield services
            finally:
                flights.close()
                pool.stop()

    def mission_counts(self) -> dict[str, int]:
        """Mission versions by status; none while the store cannot be used, so that the other metrics still show."""
        try:
            return self.store.missions.counts()
        except StoreUnavailable:
            return {}

    def plan_of(self, record: MissionRecord) -> Plan:
        """The plan of a planned version."""
        assert record.plan_sha256 is not None

        def load() -> Plan:
            return read_plan(self.store.missions.plan(record.id, record.version))

        return self.plans.get(record.plan_sha256, load)
