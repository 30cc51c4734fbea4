"""What a flight that did not go as planned is told as: never with another state's reason, never "as planned"."""

from __future__ import annotations

import pytest

from api.cli.commands.flight_view import FlightView, result_lines
from api.cli.commands.fly import conclude
from api.cli.console import Progress
from api.cli.errors import ContingencyError
from gcs.flight import FlightState
from link.streamer.supervisor import FlightResult
from tests.support.plans.planned import relay_plan


def cruising() -> FlightView:
    view = FlightView(relay_plan(), Progress())
    view.show("state", 0.0, "cruise", {"to": "cruise", "from": "transit", "reason": "T+0"})
    return view


def test_the_reason_of_a_state_that_is_over_is_not_told_as_that_of_the_end() -> None:
    result = FlightResult(FlightState.LOST, 4, "the streamer died (exit code -9)")
    with pytest.raises(ContingencyError) as failed:
        conclude(relay_plan(), result, cruising())
    block = failed.value.block()
    assert "what:     the streamer died (exit code -9)" in block
    assert "T+0\n" not in block
    view = cruising()
    view.show("state", 9.0, "lost", {"to": "lost", "from": "cruise", "reason": "nothing was heard for 120 s"})
    with pytest.raises(ContingencyError) as failed:
        conclude(relay_plan(), FlightResult(FlightState.LOST, 4, ""), view)
    assert "what:     nothing was heard for 120 s" in failed.value.block()


@pytest.mark.parametrize("state", [FlightState.LOST, FlightState.REFUSED, FlightState.CONTINGENCY])
def test_an_end_nobody_gave_a_reason_for_says_so(state: FlightState) -> None:
    with pytest.raises(ContingencyError) as failed:
        conclude(relay_plan(), FlightResult(state, 4, ""), cruising())
    assert "no reason was told" in failed.value.block()


def test_as_planned_is_never_said_after_an_abort_or_far_off_the_plan() -> None:
    def told(view: FlightView, **summary: float) -> str:
        figures = {"setpoints": 9, "tracking_rms_m": 0.5, "tracking_worst_m": 1.0, **summary}
        result = FlightResult(FlightState.COMPLETED, 0, "landed", figures)
        return result_lines(relay_plan(), result, None, view.not_planned)[0]

    assert told(cruising()) == "flight report: arrived, flown as planned"
    assert told(cruising(), tracking_worst_m=54.65).endswith("not as planned: up to 54.6 m from where the plan had it")
    assert told(cruising(), late_s=1.9) == "flight report: arrived, flown as planned"
    assert told(cruising(), late_s=17.6).endswith("arrived, not as planned: 17.6 s late")
    for word in ("abort", "land"):
        view = cruising()
        view.show("word", 3.0, "cruise", {"word": word})
        assert told(view).endswith(f"arrived, not as planned: '{word}' was commanded")
