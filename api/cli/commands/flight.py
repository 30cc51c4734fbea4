"""``skyrelay flight``: operator commands to a flight, of the service or of ``fly``: hold, resume, abort, land."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal
from urllib.parse import quote

import typer

from api.cli.errors import BadInputError, FaultError, InfeasibleError

if TYPE_CHECKING:
    from api.cli.rest_client import ServiceClient
    from link.streamer import RegisteredFlight

_FRAMES = (("lat_deg", "lon_deg", "alt_amsl_m"), ("east_m", "north_m", "up_m"))


def register(app: typer.Typer, panel: str) -> None:
    """Add the command."""
    app.command("flight", rich_help_panel=panel)(flight)


def flight(
    flight_id: Annotated[
        str | None, typer.Argument(metavar="[FLIGHT]", help="Its id; left out, the flights under way are listed.")
    ] = None,
    command: Annotated[
        Literal["look", "attach", "hold", "resume", "abort", "land", "replan", "accept"],
        typer.Argument(
            help="look: where it is; attach: show it until it ends (of `fly`); "
            "hold: stop on the path; resume: go on; abort: the contingency procedure in force; "
            "land: at once, wherever that is; replan: propose a plan from here; accept: fly the plan proposed."
        ),
    ] = "look",
    service: Annotated[
        str, typer.Option("--service", metavar="URL", help="The service.", envvar="SKYRELAY_SERVICE")
    ] = "http://127.0.0.1:8000",
    destination: Annotated[
        str | None,
        typer.Option(metavar="A,B,C", help="replan: to there; latitude, longitude, altitude AMSL, or east,north,up."),
    ] = None,
    exclude: Annotated[
        list[str] | None, typer.Option(metavar="STATION", help="replan: without this station; may be repeated.")
    ] = None,
    ahead_s: Annotated[
        float, typer.Option("--ahead", metavar="S", min=5, max=600, help="replan: how far ahead it begins, in flight.")
    ] = 30.0,
    plan_sha256: Annotated[
        str | None, typer.Option("--plan", metavar="SHA256", help="accept: the hash of the plan proposed.")
    ] = None,
    by: Annotated[str | None, typer.Option(metavar="NAME", help="Who commands it, for the record.")] = None,
    reason: Annotated[str | None, typer.Option(metavar="TEXT", help="Why, for the record.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the service's answer.")] = False,
) -> int:
    """Look at a flight, of the service or of `fly`, and command it: hold it, let it go on, end it, plan it anew.

    A plan proposed changes nothing until it is accepted: `skyrelay flight ID replan`, then `accept --plan SHA256`.
    """
    from api.cli.commands import local_flight
    from api.cli.rest_client import RefusedError, ServiceClient

    local = local_flight.find(flight_id)
    if command == "attach":
        return local_flight.attend(local, flight_id, as_json=as_json)
    client = ServiceClient(service.rstrip("/") + "/")
    try:
        # Not by way of a service that does not know it.
        if local is not None and local.flight_id.startswith("fly-"):
            raise FaultError("not the service's")
        answer, text = _asked(
            client,
            flight_id,
            command,
            {"by": by, "reason": reason},
            destination=destination,
            exclude=exclude,
            ahead_s=ahead_s,
            plan_sha256=plan_sha256,
        )
    except RefusedError as refusal:
        raise _refused(refusal.status, refusal.problem) from None
    except FaultError as fault:
        answer, text = _without_service(local, flight_id, command, {"by": by, "reason": reason}, fault)
    typer.echo(json.dumps(answer, indent=1) if as_json else text)
    return 0


def _without_service(
    local: RegisteredFlight | None, flight_id: str | None, command: str, given: Mapping[str, Any], fault: FaultError
) -> tuple[Any, str]:
    """What can be said where the service is away and the flight itself is on this machine; else raises ``fault``."""
    from api.cli.commands import local_flight

    if local is not None:
        return local_flight.command(local, command, given)
    if flight_id is None and (here := local_flight.listed(set())):
        return {"items": here}, "\n".join(map(_local_line, here)) + f"\n({fault.headline})"
    raise fault


def _local_line(one: Mapping[str, Any]) -> str:
    from api.cli.commands.flight_view import state_text

    return f"{one['id']}  {state_text(one['phase']):<12} of `fly`, over {', '.join(one['links'])}"


def _asked(
    service: ServiceClient,
    flight_id: str | None,
    command: str,
    given: Mapping[str, Any],
    *,
    destination: str | None,
    exclude: list[str] | None,
    ahead_s: float,
    plan_sha256: str | None,
) -> tuple[Any, str]:
    """The service's answer, and what it is in words. Raises `api.cli.rest_client.RefusedError`, `BadInputError`."""
    from api.cli.commands import local_flight
    from api.cli.commands.flight_view import state_text

    if flight_id is None:
        flights = service.call("GET", "v1/flights?active=true&limit=200")
        lines = [f"{f['id']}  {state_text(f['phase']):<12} vehicle {f['vehicle_id']}" for f in flights["items"]]
        here = local_flight.listed({f["id"] for f in flights["items"]})
        lines += map(_local_line, here)
        flights = {**flights, "items": flights["items"] + here}
        return flights, "\n".join(lines) or "no flight is under way"
    address = f"v1/flights/{quote(flight_id, safe='')}"
    if command == "replan":
        body: dict[str, Any] = {**given, "ahead_s": ahead_s}
        if destination is not None:
            frame = service.call("GET", f"{address}/plan")["mission"]["destination"]
            body["destination"] = _place(destination, frame)
        if exclude:
            body["excluded_stations"] = exclude
        proposal = service.call("POST", f"{address}/replan", body)
        return proposal, _proposed(flight_id, proposal)
    if command == "accept":
        if plan_sha256 is None:
            raise BadInputError(
                "which plan is accepted?",
                {"where": "--plan", "fix": f"ask for one with `skyrelay flight {flight_id} replan`, and give its hash"},
            )
        answer = service.call("POST", f"{address}/replan/accept", {**given, "plan_sha256": plan_sha256})
    elif command == "look":
        answer = service.call("GET", address)
    else:
        answer = service.call("POST", f"{address}/{command}", dict(given))
    return answer, _shown(answer)


def _place(text: str, frame: Mapping[str, Any]) -> dict[str, float]:
    """A place in the mission's own frame. Raises `BadInputError`."""
    names = next(names for names in _FRAMES if set(names) <= set(frame))
    try:
        values = [float(part) for part in text.split(",")]
        return dict(zip(names, values, strict=True))
    except ValueError:
        raise BadInputError(
            "the destination cannot be read",
            {"where": "--destination", "value": text, "allowed": f"three numbers: {','.join(names)}"},
        ) from None


def _shown(answer: Mapping[str, Any]) -> str:
    """A flight now, in a line or two."""
    from api.cli.commands.flight_view import clock, lapse_text, state_text

    live = answer["live"]
    parts = [state_text(answer["phase"])]
    if live["t_plus_s"] is not None:
        parts.append(f"T+ {clock(live['t_plus_s'])}")
    if live["station"] is not None:
        parts.append(f"{live['station']} in control")
    if live["margin_m"] is not None:
        margin_m = live["margin_m"]
        parts.append(f"{margin_m:.0f} m of range left" if margin_m >= 0.0 else f"{-margin_m:.0f} m OUT OF RANGE")
    following = live["next_handover"]
    if following:
        parts.append(f"{following['to']} takes over in {clock(max(0.0, following['in_s']))}")
    line = f"flight {answer['id']}: {', '.join(parts)}"
    line = f"{line}\n  {live['reason']}" if live["reason"] else line
    return f"{line}\n  {lapse_text(live['lapse'])}" if live.get("lapse") else line


def _proposed(flight_id: str, proposal: Mapping[str, Any]) -> str:
    from api.cli.commands.flight_view import clock

    until = proposal["decide_by_t_plus_s"]
    lines = [
        f"plan {proposal['plan_sha256']}",
        f"  over {', '.join(proposal['stations'])}; it ends at T+ {clock(proposal['mission_time_s'])} of the plan",
        *(
            f"  handover {h['index']}, {h['from']} to {h['to']}: T+ {clock(h['t_plus_s'])}"
            for h in proposal["handovers"]
        ),
        *(
            f"  {check['level']}: {check['name']}: {check['message']}; {check['fix']}"
            for check in proposal["checks"]
            if check["level"] != "pass"
        ),
        "  the flight stands and waits" if until is None else f"  to be accepted before T+ {clock(until)}",
        f"accept it with: skyrelay flight {flight_id} accept --plan {proposal['plan_sha256']}",
    ]
    return "\n".join(lines)


def _refused(status: int, problem: Mapping[str, Any]) -> Exception:
    """The service's refusal as the command line says it."""
    detail = str(problem.get("detail") or problem.get("title") or f"status {status}")
    faults = [fault for fault in problem.get("errors") or [] if isinstance(fault, dict)]
    if problem.get("reason") is not None:
        where, gap_m = problem.get("where"), problem.get("gap_m")
        return InfeasibleError(detail, {"reason": problem["reason"], "where": where, "gap_m": gap_m})
    return BadInputError(detail, *faults)
