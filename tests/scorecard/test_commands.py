"""Scorecard 37: every operator command in every state has its stated effect, on both autopilots."""

from __future__ import annotations

import pytest

import tests.scorecard.command_effects as table
from gcs.flight import FlightState, OperatorCommand
from gcs.operator_commands import PHASES
from tests.support.flights.forks import in_fork

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


def test_every_state_has_a_moment_and_every_phase_a_limit() -> None:
    assert {moment.state for moment in table.MOMENTS} == set(FlightState)
    assert set(PHASES) == {state for state in FlightState if not state.ended}


def test_the_page_is_the_table() -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    assert text == table.page(), "run `python -m tests.scorecard.command_effects > docs/commands.md`"


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("moment", table.MOMENTS, ids=lambda moment: moment.name)
def test_every_command_in_every_state_has_its_stated_effect(moment: table.Moment, autopilot: str) -> None:
    one = table.reach(moment, autopilot)
    problems = {
        command.value: found
        for command in OperatorCommand
        if (found := in_fork(lambda command=command: table.try_cell(one, moment, command)))  # type: ignore[misc]
    }
    assert problems == {}
