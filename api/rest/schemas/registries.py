"""Stations, links and vehicles known by name."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from api.rest.schemas.base import Closed, Text, Whole


class RegisteredStation(Closed):
    """A ground station (remote pilot station) known by name."""

    lat_deg: float = Field(ge=-90, le=90, allow_inf_nan=False, examples=[52.9234])
    lon_deg: float = Field(ge=-180, le=180, allow_inf_nan=False, examples=[4.7806])
    alt_amsl_m: float = Field(ge=-1000, le=50_000, description="Of the antenna, above mean sea level.", examples=[1.0])
    range_m: float = Field(gt=0, le=500_000, description="Slant range of its C2 link, m.", examples=[16000.0])
    name: Text | None = Field(None, max_length=200)
    system_id: Whole | None = Field(None, ge=1, le=254, description="Its MAVLink id.")
    contact: Text | None = Field(None, max_length=200)
    radio_channel: Text | None = Field(None, max_length=200)
    hours: Text | None = Field(None, max_length=200, description="When it is staffed, for people.")
    min_elevation_deg: float | None = Field(None, ge=0, le=85)


class RegisteredLink(Closed):
    """A C2 link: where a station's radio is reached."""

    url: Text = Field(
        max_length=200,
        description="udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.",
        examples=["udpout:127.0.0.1:14540"],
    )
    signing_key: str | None = Field(
        None,
        max_length=500,
        pattern=r"^(file:/.+|env:[A-Za-z_][A-Za-z0-9_]*)$",
        description="Where the service finds the key that signs this link: file:/PATH or env:NAME.",
        examples=["file:/etc/skyrelay/medic-1.key"],
    )
    allow_unsigned: bool | None = Field(
        None, description="Whether a flight may use it unsigned where it leaves the service's machine; default false."
    )
    description: Text | None = Field(None, max_length=500)


class RegisteredVehicle(Closed):
    """A vehicle and the C2 links that lead to it."""

    autopilot: Literal["px4", "ardupilot"]
    links: dict[Text, Text] = Field(
        min_length=1,
        max_length=1000,
        description="Link by station id; `*` stands for every station not named.",
        examples=[{"*": "simulator"}],
    )
    name: Text | None = Field(None, max_length=200)


class RestoreRequest(Closed):
    """How a vehicle is given back what flights left changed on it."""

    unlock: bool = Field(
        False, description="Where no note says what was there before: let every ground station be heard again."
    )


class Restored(Closed):
    """What was given back to a vehicle, by parameter or list."""

    url: str
    system_id: int
    notes: int = Field(description="Flights that had left something.")
    given_back: list[str]
    as_before: list[str] = Field(description="Back already.")
    foreign: list[str] = Field(description="Changed by somebody else since, and left as they are.")
    failed: list[str]
    locked: bool = Field(description="Whether it still hears only the stations it names.")


class Entry(Closed):
    """What the registry adds to an entry."""

    id: str
    revision: int = Field(ge=1, description="How often it was written; for If-Match.")
    created_utc: str
    changed_utc: str


class StationEntry(Entry, RegisteredStation):
    """A ground station as the registry shows it."""


class LinkEntry(Entry, RegisteredLink):
    """A link as the registry shows it."""


class VehicleEntry(Entry, RegisteredVehicle):
    """A vehicle as the registry shows it."""


class RegistryPage(Closed):
    """Entries in order of their names. ``next`` goes into ``cursor`` for the page after this one; null at the end."""

    items: list[dict[str, Any]]
    next: str | None
