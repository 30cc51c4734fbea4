"""``skyrelay doctor --vehicle URL``: who a vehicle is, and whether its parameters are fit for a flight.

Asked through MAVSDK, a client nobody here wrote, and judged by what judges them before a flight
(`link.preflight.failsafe_parameters`, `link.preflight.vehicle`): the two must agree on what the vehicle said. Nothing
is written to the vehicle. MAVSDK keeps its heartbeats going by itself, so a link that a flight uses is refused.
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Iterator
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from api.cli.errors import EXIT_CONTINGENCY, BadInputError

if TYPE_CHECKING:
    from link.autopilot import AutopilotProfile
    from link.microservices import Parameter
    from link.preflight import Check, Identity
    from link.transport import LinkUrl

RATE_HZ = 20.0
"""Setpoints a second the time-outs are judged for, that of `fly` unless told otherwise."""
_SCHEMES = {"udpin": "udpin://{host}:{number}", "udpout": "udpout://{host}:{number}", "tcp": "tcpout://{host}:{number}"}
_SCHEMES |= {"serial": "serial://{host}:{number}"}
_TOLD_TRIES = 3
_TOLD_WAIT_S = 2.0


def examine(url: str, *, system_id: int, timeout_s: float, as_json: bool) -> int:
    """Look at the vehicle behind a link URL and print the findings; 0 when it is fit for a flight, else 4.

    Raises `BadInputError` for a URL that cannot be used, one nobody answers on, or where MAVSDK is not installed.
    """
    from link.preflight import Level, worst, worst_first

    address = _address(url)
    owned = _ownership(url, system_id, timeout_s)
    with _client(url, address, system_id) as client:
        system = client.first_autopilot(timeout_s)
        if system is None:
            raise BadInputError(
                "no vehicle answers",
                {
                    "where": "--vehicle",
                    "value": url,
                    "what": f"no autopilot was heard in {timeout_s:g} s",
                    "fix": "is it powered and the link right? a simulator that listens (udpin) is reached with udpout",
                },
            )
        profile, vehicle, checks = _judge(system, url)
    checks += owned
    fit = worst(checks) < Level.FAILURE
    checks = worst_first(checks)
    if as_json:
        import typer

        document = {"vehicle": vehicle, "fit": fit, "checks": [check.to_document() for check in checks]}
        typer.echo(json.dumps(document, indent=2, allow_nan=False))
    else:
        _print(profile, checks, fit=fit)
    return 0 if fit else EXIT_CONTINGENCY


def _address(url: str) -> LinkUrl:
    from link.errors import EndpointUrlError
    from link.transport import parse_url

    try:
        return parse_url(url)
    except EndpointUrlError as error:
        raise BadInputError("the link cannot be read", {"where": "--vehicle", "what": str(error)}) from None


@contextlib.contextmanager
def _client(url: str, address: LinkUrl, system_id: int) -> Iterator[Any]:
    """MAVSDK on the link, which no flight of this machine may use meanwhile."""
    from link.errors import EndpointError
    from link.transport import LinkLocks

    try:
        import mavsdk
        from mavsdk.logging import log_subscribe
    except ImportError:
        raise BadInputError(
            "a vehicle is looked at through MAVSDK, which is not installed",
            {"where": "--vehicle", "fix": "pip install 'skyrelay[witness]'"},
        ) from None
    try:
        locks = LinkLocks([url])
    except EndpointError as error:
        raise BadInputError("the link is in use", {"where": "--vehicle", "what": str(error)}) from None
    # Its log would stand in the middle of ours.
    log_subscribe(lambda *_: True)
    client = mavsdk.Mavsdk(mavsdk.Configuration.create_manual(system_id, 190, always_send_heartbeats=True))
    try:
        host = f"[{address.host}]" if ":" in address.host else address.host
        result = client.add_any_connection(_SCHEMES[address.scheme].format(host=host, number=address.number))
        if result.value != 0:
            what = f"MAVSDK cannot open it: {result.name.lower().replace('_', ' ')}"
            raise BadInputError("the link cannot be opened", {"where": "--vehicle", "value": url, "what": what})
        yield client
    finally:
        client.destroy()
        locks.release()


def _judge(system: Any, url: str) -> tuple[AutopilotProfile, dict[str, Any], list[Check]]:
    """What the vehicle is, and the findings about it."""
    from link.autopilot import PROFILES
    from link.preflight import judge_failsafes, judge_identity

    kind = system.autopilot_type().name.lower()
    if kind not in PROFILES:
        what, allowed = f"its autopilot is {kind}", ", ".join(known.title for known in PROFILES.values())
        fix = "fly a vehicle with one of those"
        raise BadInputError(
            "the vehicle's autopilot is not known here",
            {
                "where": "--vehicle",
                "value": url,
                "what": what,
                "allowed": allowed,
                "fix": fix,
            },
        )
    profile = PROFILES[kind]
    identity, vehicle_type = _identity(system)
    values = _values(system, profile)
    checks = [*judge_identity(profile, identity, vehicle_type), _told(values, url)]
    checks += judge_failsafes(profile, values, RATE_HZ)
    vehicle = {
        "url": url,
        "system_id": system.get_system_id(),
        "autopilot": profile.name,
        "version": None if identity is None else ".".join(map(str, identity.version)),
        "release": None if identity is None else identity.release,
        "git_hash": None if identity is None else identity.git_hash,
        "board": None if identity is None else identity.board,
        "parameters": {p.name: p.value for p in values.values() if p is not None},
    }
    return profile, vehicle, checks


def _ownership(url: str, asked_as: int, timeout_s: float) -> list[Check]:
    """Whom it hears, what flights left changed on it, whether it signs; nothing where it is not heard."""
    from api.cli.commands.vehicle import ownership_text
    from link.errors import LinkError
    from link.files import FileJournal
    from link.preflight import Check, Level
    from link.streamer import open_vehicle_client

    try:
        with open_vehicle_client(url, timeout_s=timeout_s) as client:
            told = client.identify(FileJournal())
    except LinkError:
        return []  # why, the other client says
    signed = "its frames are signed: a flight needs its key" if told["signed"] else "its frames are not signed"
    checks = [Check("signing", Level.PASS, signed, told["signed"])]
    left = [note for note in told["left_by"] if not note["flies"]]
    restore = f"skyrelay vehicle restore --link {url}"
    if left:
        what = "; ".join(f"flight {note['flight']} left changed: {', '.join(note['changed'])}" for note in left)
        checks.append(Check("left by flights", Level.WARNING, what, len(left), "nothing", fix=restore))
    level, ids = Level.PASS, sorted(v for name, v in told["gcs_ids"].items() if "SYSID" in name and v and v < 255)
    if told["locked"]:
        heard = bool(ids) and ids[0] <= asked_as <= ids[-1]
        level = Level.WARNING if heard else Level.FAILURE
    fix = restore if left else f"{restore} --unlock, or fly with those ids, or with --rescue"
    return [
        *checks,
        Check("ownership", level, ownership_text(told), told["locked"], "heard by whoever flies it", fix=fix),
    ]


def _identity(system: Any) -> tuple[Identity | None, int | None]:
    """Who the vehicle says it is (AUTOPILOT_VERSION) and its MAV_TYPE (HEARTBEAT); None for what was not told."""
    from mavsdk.plugins.mavlink_direct import MavlinkDirect
    from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirectError, MavlinkMessage

    from link.preflight import Identity

    heard: dict[str, SimpleNamespace] = {}
    told = threading.Event()

    def take(message: Any, _data: object) -> None:
        # Gimbals and modems of the vehicle speak too.
        if message.system_id == system.get_system_id() and message.component_id == 1:
            heard[message.message_name] = SimpleNamespace(**json.loads(message.fields_json))
            if "HEARTBEAT" in heard and "AUTOPILOT_VERSION" in heard:
                told.set()

    direct = MavlinkDirect(system)
    handles = [direct.subscribe_message(name, take) for name in ("HEARTBEAT", "AUTOPILOT_VERSION")]
    fields = {"target_system": system.get_system_id(), "target_component": 1, "command": 512, "confirmation": 0}
    fields |= {f"param{k}": 148.0 if k == 1 else 0.0 for k in range(1, 8)}
    request = MavlinkMessage("COMMAND_LONG", 0, 0, fields["target_system"], 1, json.dumps(fields))
    for _ in range(_TOLD_TRIES):
        with contextlib.suppress(MavlinkDirectError):
            direct.send_message(request)
        if told.wait(_TOLD_WAIT_S):
            break
    for handle in handles:
        direct.unsubscribe_message(handle)
    version, heartbeat = heard.get("AUTOPILOT_VERSION"), heard.get("HEARTBEAT")
    identity = None if version is None else Identity.from_message(version)
    return identity, None if heartbeat is None else int(heartbeat.type)


def _values(system: Any, profile: AutopilotProfile) -> dict[str, Parameter | None]:
    """The parameters the profile knows, of the whole list the vehicle tells."""
    from mavsdk.plugins.param import Param

    from link.dialect import mavlink
    from link.microservices import Parameter

    client = Param(system)
    told: dict[str, Parameter] = {}
    for _ in range(_TOLD_TRIES):
        everything = client.get_all_params()
        for one in everything.int_params:
            told[one.name] = Parameter(one.name, int(one.value), mavlink.MAV_PARAM_TYPE_INT32)
        for one in everything.float_params:
            told[one.name] = Parameter(one.name, float(one.value), mavlink.MAV_PARAM_TYPE_REAL32)
        if told:
            break
    return {known.key: next((told[name] for name in known.names if name in told), None) for known in profile.parameters}


def _told(values: dict[str, Parameter | None], url: str) -> Check:
    from link.preflight import Check, Level

    count = sum(value is not None for value in values.values())
    fix = "it may hear other stations' ids alone: give --system-id one of those; or the link loses too much"
    return Check(
        "parameters",
        Level.PASS if count else Level.ERROR,
        f"{count} of the {len(values)} a flight looks at were told" if count else "it tells none of its parameters",
        url,
        "told",
        fix=fix,
    )


def _print(profile: AutopilotProfile, checks: list[Check], *, fit: bool) -> None:
    from rich.table import Table
    from rich.text import Text

    from api.cli import console

    colours = {"pass": "green", "warning": "yellow", "failure": "red", "error": "bold red"}
    table = Table(box=None, pad_edge=False, show_header=False)
    for check in checks:
        word = check.level.name.lower()
        value = "" if check.value is None or not isinstance(check.value, int | float) else f" is {check.value:g}"
        required = f" (required: {check.required})" if check.required and word != "pass" else ""
        body = f"{check.message}{required}" + (f"\n→ {check.remedy}" if check.remedy else "")
        table.add_row(Text(word, style=colours[word]), f"{check.name}{value}", Text(body))
    console.out().print(table)
    console.out().print(
        f"{profile.title}: fit for a flight" if fit else f"{profile.title}: NOT fit for a flight; see above what to do"
    )
