"""Vehicles outside any flight: what a flight left changed is given back, when asked and by a service that starts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import structlog

from gcs.errors import ConflictError
from gcs.store import Store
from link.errors import EndpointError, LinkError, VehicleError
from link.files import FileJournal
from link.streamer import open_vehicle_client

log = structlog.get_logger("api.vehicles")

_LISTEN_S = 10.0
# A vehicle whose streamer died in the air comes back and lands; so long it is looked for.
_PAUSES_S = (0.0, 15.0, 30.0, *[60.0] * 30)


def restore_vehicle(store: Store, vehicle_id: str, *, unlock: bool) -> dict[str, Any]:
    """Give back what the journal notes of a registered vehicle, over its links in turn (`link.streamer.VehicleClient`).

    Raises `gcs.errors.NotFoundError`, `ConflictError` (it does not answer, is armed, or flies).
    """
    vehicle = store.registry.get("vehicle", vehicle_id).document
    entries = [store.registry.get("link", name).document for name in dict.fromkeys(vehicle["links"].values())]
    why = "it has no link"
    for entry in entries:
        try:
            return _restored(str(entry["url"]), entry.get("signing_key"), None, unlock=unlock)
        except LinkError as error:
            why = str(error)
    raise ConflictError(f"nothing was given back: {why}")


def _restored(
    url: str, key: str | None, state: str | None, *, system_id: int | None = None, unlock: bool = False
) -> dict[str, Any]:
    with open_vehicle_client(
        url, system_id=system_id, signing_key=key, signing_state=state, timeout_s=_LISTEN_S
    ) as client:
        return client.restore(FileJournal(), unlock=unlock)


class Restorer:
    """Gives back, in a thread of its own, what this service's own flights left when their streamers died.

    A flight's own streamer does so first; nothing is touched while one runs, or while the vehicle is armed.
    """

    def __init__(self, data_dir: Path) -> None:
        self._data_dir = data_dir
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def start(self) -> None:
        """Look for what is left, now and for a while; while that goes on already, nothing more."""
        with self._lock:
            if self._stopped.is_set() or (self._thread is not None and self._thread.is_alive()):
                return
            self._thread = threading.Thread(target=self._run, name="restorer", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Begin nothing new; what is begun is finished by whoever comes next."""
        self._stopped.set()

    def _run(self) -> None:
        for pause_s in _PAUSES_S:
            if self._stopped.wait(pause_s) or not self._round(self._stopped.is_set):
                return

    def _round(self, stopped: Callable[[], bool]) -> bool:
        """Once over all notes; whether any is left."""
        journal = FileJournal()
        left = False
        for note in journal.pending():
            if note.run_dir is None or not Path(note.run_dir).is_relative_to(self._data_dir) or stopped():
                continue
            left = True
            if journal.in_use(note):
                continue
            for url in note.urls:
                try:
                    done = _restored(url, note.signing_key, note.signing_state, system_id=note.system_id)
                except (EndpointError, VehicleError) as error:
                    log.info("vehicle not asked", flight=note.flight_id, link=url, why=str(error))
                    continue
                except (LinkError, OSError) as error:
                    log.warning("vehicle not asked", flight=note.flight_id, link=url, why=str(error))
                    continue
                log.info("given back what a flight left", flight=note.flight_id, **_shown(done))
                break
        return left


def _shown(done: Mapping[str, Any]) -> dict[str, Any]:
    return {key: done[key] for key in ("given_back", "foreign", "failed")}
