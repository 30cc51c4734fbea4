"""``skyrelay vehicle``: who a vehicle is and whom it hears; what flights left changed on it, given back."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from api.cli.errors import EXIT_CONTINGENCY, BadInputError

if TYPE_CHECKING:
    from link.streamer import VehicleClient

vehicle = typer.Typer(
    no_args_is_help=True, help="Identify a vehicle, or give back what flights left changed on it (from the journal)."
)

_Link = Annotated[
    str,
    typer.Option(
        "--link",
        metavar="URL",
        help="Where it is reached: udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.",
    ),
]
_Key = Annotated[
    str | None, typer.Option("--signing-key", metavar="file:PATH|env:NAME", help="Sign every frame with this key.")
]
_System = Annotated[
    int | None, typer.Option("--vehicle-id", min=1, max=255, help="Its system id, where several are on the link.")
]
_Timeout = Annotated[float, typer.Option("--timeout", min=1.0, max=600.0, help="Seconds to wait for the vehicle.")]
_Json = Annotated[bool, typer.Option("--json", help="Print the findings as JSON.")]


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands."""
    app.add_typer(vehicle, name="vehicle", rich_help_panel=panel)


@vehicle.command("identify")
def identify(
    link: _Link, vehicle_id: _System = None, signing_key: _Key = None, timeout: _Timeout = 15.0, as_json: _Json = False
) -> None:
    """Say who it is, what it does, whom it hears and how it signs. Nothing is written to it."""
    from link.files import FileJournal

    told = _with_client(link, vehicle_id, signing_key, timeout, lambda client: client.identify(FileJournal()))
    typer.echo(json.dumps(told, indent=1) if as_json else "\n".join(identity_lines(told)))


@vehicle.command("restore")
def restore(
    link: _Link,
    vehicle_id: _System = None,
    signing_key: _Key = None,
    unlock: Annotated[
        bool,
        typer.Option("--unlock", help="Where no note says what was before: let every ground station be heard again."),
    ] = False,
    ids_while_armed: Annotated[
        bool, typer.Option("--ids-while-armed", help="Give an armed vehicle its GCS ids back, and nothing else.")
    ] = False,
    timeout: _Timeout = 15.0,
    as_json: _Json = False,
) -> int:
    """Give back what flights that died left changed: GCS ids, rally points, geofence. On the ground, disarmed.

    What somebody else has changed since stays as it is. Ends with 4 when something could not be given back.
    """
    from link.files import FileJournal

    done = _with_client(
        link,
        vehicle_id,
        signing_key,
        timeout,
        lambda client: client.restore(FileJournal(), unlock=unlock, ids_while_armed=ids_while_armed),
    )
    typer.echo(json.dumps(done, indent=1) if as_json else "\n".join(restored_lines(done)))
    return EXIT_CONTINGENCY if done["failed"] else 0


def _with_client(
    url: str, system_id: int | None, key: str | None, timeout_s: float, ask: Callable[[VehicleClient], dict[str, Any]]
) -> dict[str, Any]:
    from link.errors import LinkError
    from link.streamer import open_vehicle_client, registered_flights

    try:
        with open_vehicle_client(url, system_id=system_id, signing_key=_checked(key), timeout_s=timeout_s) as client:
            return ask(client)
    except LinkError as error:
        flies = next((one for one in registered_flights() if url in one.urls), None)
        fix = None if flies is None else f"it is flown: skyrelay flight {flies.flight_id}"
        raise BadInputError(
            "the vehicle cannot be asked", {"where": "--link", "what": str(error), "fix": fix}
        ) from None


def _checked(key: str | None) -> str | None:
    if key is not None and not (key.startswith(("file:", "env:")) and key.split(":", 1)[1]):
        raise BadInputError(
            "the key is not named", {"where": "--signing-key", "allowed": "file:PATH or env:NAME", "fix": "name it"}
        )
    return key


def identity_lines(told: Mapping[str, Any]) -> list[str]:
    """What `link.streamer.VehicleClient.identify` found, for people."""
    signed = "signed" if told["signed"] else "not signed"
    lines = [
        f"{told['autopilot']} {told['version'] or '(tells no version)'}, system {told['system_id']}",
        f"  own id     {told['uid'] or 'tells none'}",
        f"  now        {'armed' if told['armed'] else 'disarmed'}, {told['mode']}",
        f"  frames     {signed}",
        f"  ownership  {ownership_text(told)}",
    ]
    for note in told["left_by"]:
        state = "flies it and has changed" if note["flies"] else "left changed"
        lines.append(f"  flight {note['flight']} ({note['utc']}) {state}: {', '.join(note['changed'])}")
    if told["locked"] or any(not note["flies"] for note in told["left_by"]):
        unlock = "" if told["left_by"] else " --unlock"
        lines.append(f"give it back with: skyrelay vehicle restore --link {told['url']}{unlock}")
    return lines


def ownership_text(told: Mapping[str, Any]) -> str:
    """Whom a vehicle hears."""
    ids = dict(told["gcs_ids"])
    if not ids:
        return "hears every ground station" if told["answers"] else "does not tell whom it hears, and answers nothing"
    values = ", ".join(f"{name} {value}" for name, value in ids.items())
    return f"{'LOCKED to the stations named' if told['locked'] else 'hears every ground station'} ({values})"


def restored_lines(done: Mapping[str, Any]) -> list[str]:
    """What `link.streamer.VehicleClient.restore` did, for people."""
    texts = (
        ("given_back", "given back"),
        ("as_before", "as before already"),
        ("foreign", "changed by somebody else since, left as it is"),
        ("failed", "NOT given back"),
    )
    lines = [f"{text}: {', '.join(done[key])}" for key, text in texts if done[key]]
    if not lines:
        lines = ["no flight of this machine left anything changed on it"]
    if done["locked"]:
        lines.append("it is still locked to other stations' ids; --unlock ends that")
    return lines
