"""Profiles of an estimate, as a user asks for them."""

import numpy as np
import pytest

from jointid.diagnostics.intervals import intervals
from jointid.paper.twin import twin
from tests.estimates import identify

AXIS = twin(noise="white", seed=4)
SIDES = ("motor_viscous", "load_viscous")
RECORD = AXIS.record.without("motor_position", "load_position")


@pytest.fixture(scope="module")
def estimate():  # type: ignore[no-untyped-def]
    return identify(RECORD, AXIS.loop)


@pytest.mark.slow
def test_profiles_agree_with_the_table_where_the_criterion_is_a_parabola(estimate) -> None:  # type: ignore[no-untyped-def]
    found = intervals(estimate, RECORD, ["stiffness", "compliance", "motor_viscous + load_viscous"])
    stiffness, compliance, total = found
    both = estimate.covariance_of(SIDES).std_of(np.ones(len(SIDES)))
    low, high = (1 / (end or 1.0) for end in reversed(compliance.interval))
    for profile, value, std in (
        (stiffness, estimate.values["stiffness"], estimate["stiffness"].stderr),
        (total, sum(estimate.values[name] for name in SIDES), both),
    ):
        assert profile.bounded
        assert profile.interval[0] == pytest.approx(value - 2 * std, abs=0.2 * std)
        assert profile.interval[1] == pytest.approx(value + 2 * std, abs=0.2 * std)
    assert (low, high) == pytest.approx(stiffness.interval, rel=1e-3)
