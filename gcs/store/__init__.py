"""What is kept: missions, plans, flights, registries; SQLite by default."""

from gcs.store.data_owner import DataOwner
from gcs.store.flights import FlightRecord
from gcs.store.missions import Idempotency, MissionRecord
from gcs.store.registries import Entry
from gcs.store.safety_copy import back_up, restore
from gcs.store.store import Store

__all__ = ["DataOwner", "Entry", "FlightRecord", "Idempotency", "MissionRecord", "Store", "back_up", "restore"]
