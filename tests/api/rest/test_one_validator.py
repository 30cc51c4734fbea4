"""The description and the reader judge alike: what the schema allows is taken, what it forbids is refused.

Fields are changed one at a time; rules between fields (bounds that cross, ids used twice) are the reader's alone.
"""

from __future__ import annotations

import copy
import json
import math
from dataclasses import fields
from typing import Any

import httpx
import pytest
from pydantic import ValidationError

from api.rest import schemas
from gcs.errors import MissionError
from gcs.mission import MissionOptions, read_mission
from tests.support.missions.malformed import GOOD

VALUES: list[Any] = [
    None, False, True, 0, 1, 1.0, 2.5, -1, -0.5, 85, 85.1, 90.5, 254, 255, 255.0, 1e4, 1e7, math.pi * 1e9, "", "x",
    " x", "1", "a" * 200, "a" * 201, "a\u200bb", "a\nb", "time", "hold", [], [1, 2, 3], [1, 2], ["x"], {}, {"x": 1},
]  # fmt: skip
PATHS = [
    *(("options", f.name) for f in fields(MissionOptions)),
    *(("limits", name) for name in schemas.MissionBody.model_fields["limits"].annotation.model_fields),  # type: ignore[union-attr]
    *(("stations", 0, name) for name in ("id", "name", "system_id", "contact", "radio_channel", "hours", "range_m")),
    ("stations", 0, "min_elevation_deg"),
    *(("start", name) for name in ("lat_deg", "lon_deg", "alt_amsl_m", "x")),
    *((name,) for name in ("name", "origin", "safe_points", "options", "limits", "stations", "start", "x")),
]
# Faults that only another field brings about.
BETWEEN = ("is below min", "has no effect without", "leaves ", "is no station", " km ", "is the vehicle's own")


def by_reader(document: Any) -> tuple[bool, str]:
    try:
        read_mission(document)
    except MissionError as error:
        return all(any(word in fault.what for word in BETWEEN) for fault in error.problems), str(error)
    return True, ""


def by_schema(document: Any) -> tuple[bool, str]:
    try:
        schemas.MissionBody.model_validate(document)
    except ValidationError as error:
        return False, str(error)
    return True, ""


@pytest.mark.parametrize("path", PATHS, ids=lambda path: ".".join(map(str, path)))
def test_a_mission_is_judged_alike_by_its_description_and_by_its_reader(path: tuple[Any, ...]) -> None:
    apart = []
    for value in VALUES:
        if path[-1] == "excluded_stations" and isinstance(value, list) and 1 in value:
            continue  # no text, and so no station either: the reader says it in these words
        document: Any = copy.deepcopy(GOOD)
        place = document
        for step in path[:-1]:
            place = place[step] if not isinstance(place, dict) else place.setdefault(step, {})
        place[path[-1]] = value
        (allowed, told), (taken, said) = by_schema(document), by_reader(document)
        if allowed != taken:
            apart.append((value, "schema: " + (told or "allowed"), "reader: " + (said or "taken")))
    assert apart == []


def test_the_description_knows_every_option() -> None:
    described = schemas.MissionBody.model_json_schema()["$defs"]["OptionsBody"]["properties"]
    assert set(described) == {f.name for f in fields(MissionOptions)}


STATION = {"lat_deg": 52.9, "lon_deg": 4.8, "alt_amsl_m": 1.0, "range_m": 16000.0}


@pytest.mark.parametrize(
    "field", ["name", "contact", "radio_channel", "hours", "system_id", "min_elevation_deg", "range_m"]
)
def test_a_station_is_judged_alike_in_the_registry_and_in_a_mission(client: httpx.Client, field: str) -> None:
    apart = []
    for value in VALUES:
        mission = copy.deepcopy(GOOD)
        mission["stations"][0][field] = value
        taken, said = by_reader(mission)
        if field == "range_m" and value is None:
            continue
        answer = client.put("/v1/stations/alike", content=json.dumps({**STATION, field: value}))
        assert answer.status_code in (200, 201, 422)
        if (answer.status_code != 422) != taken:
            apart.append((value, answer.text, said))
    assert apart == []


@pytest.mark.parametrize("bad", ["a\x00b", "a\r\nb", "a\u202eb", "a\u200bb", "a\x1b[31mb", "\ufeffa", "a\x85b"])
def test_control_characters_are_refused_in_every_registry(client: httpx.Client, bad: str) -> None:
    client.put("/v1/links/sound", json={"url": "udpout:127.0.0.1:14540"})
    bodies: dict[str, Any] = {
        "stations/x": {**STATION, "contact": bad},
        "links/x": {"url": "udpout:127.0.0.1:14540", "description": bad},
        "vehicles/x": {"autopilot": "px4", "links": {bad: "sound"}},
        "vehicles/y": {"autopilot": "px4", "links": {"*": "sound"}, "name": bad},
    }
    for path, body in bodies.items():
        answer = client.put(f"/v1/{path}", json=body)
        assert answer.status_code == 422, (path, answer.text)
