"""What a person reads of a preflight: a line for each finding, and at the end every reason with what to do."""

from __future__ import annotations

from typing import Any

import pytest

from api.cli.commands.flight_view import FlightView
from api.cli.commands.fly import conclude
from api.cli.console import Progress
from api.cli.errors import ContingencyError
from gcs.flight import FlightState
from link.streamer.supervisor import FlightResult
from tests.support.plans.planned import relay_plan


def check(name: str, level: str, **data: Any) -> dict[str, Any]:
    document = {"name": name, "level": level, "message": f"{name} is so", "value": 1, "required": "otherwise"}
    return {**document, "set": None, "fix": "mend it", **data}


def shown(*checks: dict[str, Any], capsys: pytest.CaptureFixture[str]) -> tuple[FlightView, list[str]]:
    view = FlightView(relay_plan(), Progress())
    view.show("state", None, "preflight", {"to": "preflight", "from": "identifying", "reason": ""})
    for one in checks:
        view.show("check", None, "preflight", one)
    view.show("state", None, "refused", {"to": "refused", "from": "preflight", "reason": "preflight: all of it again"})
    return view, capsys.readouterr().err.splitlines()


def test_passes_are_not_told_and_the_rest_says_what_to_do(capsys: pytest.CaptureFixture[str]) -> None:
    view, lines = shown(
        check("A", "error"), check("B", "failure"), check("C", "warning"), check("D", "pass"), capsys=capsys
    )
    assert [line.split(": ")[0].strip() for line in lines[1:4]] == [
        "preflight error",
        "preflight failure",
        "preflight warning",
    ]
    assert lines[1].endswith("A: A is so; required: otherwise; mend it")
    assert not any("D is so" in line for line in lines)
    # The reason would say all of it a second time.
    assert lines[-1].strip() == "refused: the preflight failed"
    assert [c["name"] for c in view.failed_checks] == ["A", "B"]
    # Judged again, what was mended is forgotten.
    view.show("state", None, "preflight", {"to": "preflight", "from": "ready", "reason": ""})
    assert view.failed_checks == []


def test_the_end_names_every_reason_with_its_remedy_in_terms_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    view, _ = shown(
        check("FS_GCS_ENABLE", "failure", set={"name": "FS_GCS_ENABLE", "value": 1}, fix="set FS_GCS_ENABLE to 1"),
        check("transit", "failure", fix="take the vehicle to the plan's start"),
        check("rally points", "error"),
        capsys=capsys,
    )
    result = FlightResult(state=FlightState.REFUSED, exit_code=4, reason="preflight", summary={})
    with pytest.raises(ContingencyError) as refusal:
        conclude(relay_plan(), result, view)
    block = refusal.value.block()
    assert "the flight was refused before take-off" in block
    assert "set FS_GCS_ENABLE to 1, or let `fly` do it with --set-parameters yes" in block
    assert "a simulator is put there with --home 52.95" in block
    assert block.count("where:") == 3
    assert "mend it" in block


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (0, 5, "parameter COM_OBL_RC_ACT set to 5, was 0"),
        (0, None, "parameter COM_OBL_RC_ACT could not be set, was 0"),
        (None, 0, "parameter COM_OBL_RC_ACT set to 0"),
    ],
)
def test_a_parameter_that_was_changed_says_from_what(
    before: int | None, after: int | None, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    view = FlightView(relay_plan(), Progress())
    view.show("parameter", None, "preflight", {"name": "COM_OBL_RC_ACT", "before": before, "after": after})
    assert capsys.readouterr().err.strip() == told


def test_past_the_plans_end_the_time_is_not_told_as_a_part_of_it() -> None:
    plan = relay_plan()
    view = FlightView(plan, Progress())
    assert " of 0:0" in view.where(1.0, "cruise", {"station": "s1"})
    assert view.where(plan.mission_time_s + 8.0, "landing", {"station": "s3"}).endswith(", landing")
    assert " of " not in view.where(plan.mission_time_s + 8.0, "landing", {"station": "s3"})
