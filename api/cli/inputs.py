"""What several commands take: mission and plan files, times, ``NAME=VALUE`` options; each met with a clear error."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Any

from api.cli import files
from api.cli.errors import BadInputError, InfeasibleError, faults_as_paragraphs, text_of

if TYPE_CHECKING:
    from gcs.errors import MissionError, MissionInfeasible
    from gcs.mission import Mission
    from gcs.plan import Plan
    from gcs.settings import Settings

_HERE = {"-": "standard input"}


def read_json(name: str, *, what: str) -> Any:
    """The JSON document in file ``name`` (``-``: standard input). Raises `BadInputError`."""
    from gcs.document_reader import parse_json
    from gcs.errors import MissionError

    data = files.read_bytes(name, what=what)
    try:
        return parse_json(data, max_bytes=files.MAX_DOCUMENT_BYTES)
    except MissionError as error:
        faults = faults_as_paragraphs(error.problems)
        for fault in faults:
            if fault["where"] == "mission":  # the reader's word for the whole document
                fault["where"] = what
        raise BadInputError(f"the {what} {_HERE.get(name, name)} cannot be used", *faults) from None


def mission(document: Any, name: str) -> Mission:
    """A mission from its document; ``name`` is where it came from. Raises `BadInputError` with every fault."""
    from gcs.errors import MissionError
    from gcs.mission import read_mission

    try:
        return read_mission(document)
    except MissionError as error:
        count = len(error.problems)
        number = "a fault" if count == 1 else f"{count} faults"
        raise BadInputError(f"the mission {_HERE.get(name, name)} has {number}", *paragraphs(error)) from None


def paragraphs(error: MissionError) -> list[dict[str, Any]]:
    """A mission's faults as paragraphs of a block, the first so many of them."""
    from gcs.errors import MAX_SHOWN_FAULTS

    shown = faults_as_paragraphs(error.problems[:MAX_SHOWN_FAULTS])
    if len(error.problems) > MAX_SHOWN_FAULTS:
        shown.append({"more": f"{len(error.problems) - MAX_SHOWN_FAULTS} further faults"})
    return shown


def plan(name: str) -> Plan:
    """The plan in file ``name`` (``-``: standard input). Raises `BadInputError`."""
    from gcs.errors import PlanError
    from gcs.plan import read_plan

    document = read_json(name, what="plan")
    try:
        return read_plan(document)
    except PlanError as error:
        fix = "make it anew with `skyrelay plan MISSION.json -o PLAN.json`"
        if isinstance(document, dict) and "stations" in document and "segments" not in document:
            fix = f"this looks like a mission: plan it first, `skyrelay plan {name} -o PLAN.json`"
        raise BadInputError(
            f"the plan {_HERE.get(name, name)} cannot be used",
            {"where": error.where or name, "what": str(error).removeprefix(f"{error.where}: "), "fix": fix},
        ) from None


def infeasible(error: MissionInfeasible) -> InfeasibleError:
    """The domain's finding as the command line says it: why, where, by how much, and the smallest fix."""
    told = [f"{cause['message']}\n{cause['fix_text']}".strip() for cause in error.causes]
    several = {"causes": "\n".join(f"{k}. {text}".replace("\n", "\n   ") for k, text in enumerate(told, start=1))}
    head, listed, _ = error.message.partition(", in flight order: (1) ")
    return InfeasibleError(
        head if listed and told else error.message,
        {
            **(several if told else {}),
            "reason": error.reason,
            "stations": ", ".join(error.stations),
            "where": place(error.where),
            "gap_m": None if error.gap_m is None else f"{error.gap_m:.1f}",
            "fix": error.fix_text.replace("; or ", ";\nor ") or (None if error.fix is None else text_of(error.fix)),
        },
    )


def place(where: dict[str, float] | None) -> str | None:
    """A place in words."""
    if not where:
        return None
    if "lat_deg" in where:
        text = f"{where['lat_deg']:.6f}, {where['lon_deg']:.6f}"
        return text + (f", {where['alt_amsl_m']:.0f} m AMSL" if "alt_amsl_m" in where else "")
    return ", ".join(f"{key} {value:.1f}" for key, value in where.items())


def option_values(pairs: list[str]) -> dict[str, object]:
    """``NAME=VALUE`` options as a mapping of JSON values. Raises `BadInputError` for what is not one."""
    from gcs.errors import MissionError
    from gcs.mission import parse_option

    values: dict[str, object] = {}
    for pair in pairs:
        if "=" not in pair:
            raise BadInputError(
                "an option of the mission cannot be read",
                {"where": "--option", "value": pair, "allowed": "NAME=VALUE", "fix": f"e.g. {pair.strip()}=5"},
            )
        try:
            name, value = parse_option(pair)
        except MissionError as error:
            raise BadInputError(
                "an option of the mission cannot be read", *faults_as_paragraphs(error.problems)
            ) from None
        values[name] = value
    return values


def utc_time(text: str | None, *, where: str = "--launch") -> datetime | None:
    """An RFC 3339 time with its offset, as UTC; None stays None. Raises `BadInputError`."""
    from gcs.errors import ExportError
    from gcs.exports import parse_launch

    if text is None:
        return None
    try:
        return parse_launch(text)
    except ExportError as error:
        raise BadInputError("a time cannot be read", {"where": where, "value": text, "what": str(error)}) from None


def settings(**given: object) -> Settings:
    """The service's settings: those ``given`` (None: not given), else from ``SKYRELAY_`` variables, else the defaults.

    Raises `BadInputError` for a value that cannot be used.
    """
    from pydantic import ValidationError

    from gcs.settings import Settings

    try:
        return Settings(**{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    except ValidationError as error:
        raise BadInputError(
            "the settings cannot be used",
            *(
                {
                    "where": "SKYRELAY_" + "_".join(str(part) for part in e["loc"]).upper(),
                    "what": e["msg"],
                    "value": text_of(e["input"]),
                }
                for e in error.errors()
            ),
        ) from None
