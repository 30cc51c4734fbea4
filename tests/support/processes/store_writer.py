"""A process that commits to a store as fast as it can and says so only after each commit; it is there to be killed.

``python -m tests.support.processes.store_writer URL``: prints a mission id (or a flight event's number,
negative) per committed line.
"""

from __future__ import annotations

import sys

from gcs.flight import EventKind, FlightEvent, FlightState
from gcs.mission import read_mission, write_mission
from gcs.store.missions import Idempotency
from gcs.store.store import Store
from tests.support.missions.malformed import GOOD


def main() -> None:
    store = Store(sys.argv[1])
    document = write_mission(read_mission(GOOD))
    record, _ = store.missions.add(document)
    claim = store.queue.claim("writer", 60.0)
    assert claim is not None
    assert store.queue.finish(claim, "writer", {"plan_sha256": "0" * 64})
    flight = store.flights.add(mission_id=record.id, version=1, plan_sha256="0" * 64, vehicle_id=record.id)
    print(f"flight {flight.id}", flush=True)
    for k in range(1, 100_000):
        added, _ = store.missions.add(document, idempotency=Idempotency("writer", f"{record.id}-{k}", "hash"))
        print(f"mission {added.id}", flush=True)
        store.flights.append(flight.id, event(k))
        print(f"event {k}", flush=True)


def event(sequence: int, state: FlightState = FlightState.CRUISE) -> FlightEvent:
    return FlightEvent(
        sequence, EventKind.STATE, sequence / 10, None, "2026-11-22T09:00:00.000Z", state, {"from": "x", "note": "é"}
    )


if __name__ == "__main__":
    main()
