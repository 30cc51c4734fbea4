"""Documents as the tables keep them: JSON text, byte for byte as written; and what is done about one that is torn."""

from __future__ import annotations

import json
import logging
from typing import Any

from gcs.errors import StoreUnavailable

log = logging.getLogger(__name__)


def dump(document: object) -> str:
    """JSON text of a document."""
    return json.dumps(document, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def load(text: str, what: str) -> dict[str, Any]:
    """The document again. Raises `StoreUnavailable` that names ``what`` is damaged."""
    try:
        loaded = json.loads(text)
    except ValueError:
        loaded = None
    if not isinstance(loaded, dict):
        raise StoreUnavailable(f"{what} cannot be read any more: the database is damaged; restore a safety copy")
    return loaded


def load_for_list(text: str, what: str) -> dict[str, Any] | None:
    """As `load`, but None and a line in the log: one damaged row must not hide the others from everybody."""
    try:
        return load(text, what)
    except StoreUnavailable as error:
        log.error("%s", error)
        return None
