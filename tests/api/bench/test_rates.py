"""The benchmark measures every step, and its figures are rates."""

from __future__ import annotations

from api.bench.link.rates import wire_rates
from tests.support.plans.drawn import drawn_relay_plan


def test_every_rate_is_there_beside_its_reference() -> None:
    rates = {rate.name: rate for rate in wire_rates(drawn_relay_plan(), seconds=0.01)}
    assert len(rates) == 9
    reference = rates["reference: SHA-256 of 64 bytes"]
    assert reference.per_reference == 1.0
    for rate in rates.values():
        assert rate.per_second > 0
        assert rate.per_reference * rate.per_second / reference.per_second > 0.999
    # Signing is more work than not signing; no wall time is asserted, only the order within one run.
    assert rates["sign, parse and verify"].per_reference > reference.per_reference
