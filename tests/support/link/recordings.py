"""The recorded conversations with real autopilots, message by message."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from tests.support.paths import RECORDINGS as FOLDER

NAMES = sorted(path.name.removesuffix(".jsonl.gz") for path in FOLDER.glob("*.jsonl.gz"))


def autopilot_of(name: str) -> str:
    """Which profile flew a recording."""
    return name.partition("-")[0]


@lru_cache(maxsize=4)
def load(name: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Header and messages of one recording."""
    with gzip.open(FOLDER / f"{name}.jsonl.gz", "rt") as lines:
        header, *messages = [json.loads(line) for line in lines]
    return header, messages


def received(name: str, kind: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """(time, fields) of every message of a kind the autopilot itself sent."""
    for message in load(name)[1]:
        if message["dir"] == "rx" and message["msg"] == kind and message["src"][1] == 1:
            yield message["t"], message["fields"]
