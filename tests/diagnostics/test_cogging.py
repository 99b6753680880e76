"""A force that comes back with the motor's position: found with its period, and told."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.diagnostics.suspects import FAULTS
from jointid.estimation.result.verdict import Reason
from jointid.models.position_forces import PositionHarmonics
from studies.mechanics import spoiled
from tests.estimates import faults_of, identify


@pytest.mark.slow
@pytest.mark.parametrize("seed", [100, 102, 103])
def test_the_period_of_a_ripple_is_found(seed: int) -> None:
    made = spoiled(seed, "cogging", 8.0)
    check = faults_of(identify(made.record, made.axis.loop), made.record, most=1)
    first = check.findings[0]
    assert first.test.fault is FAULTS["cogging"]
    reference = made.record.reference
    travel = float(np.ptp(reference.values))
    assert travel / first.test.shape == pytest.approx(
        travel / made.truth["pitch"], abs=0.6
    )  # half a time over the travel
    assert first.test.size == pytest.approx(made.truth["cogging"], rel=0.3)
    assert check.reasons[0].code == Reason.FORCE_FOLLOWS_POSITION
    assert "[ripple] period = " in str(check.reasons[0])


@pytest.mark.slow
def test_none_is_found_where_there_is_none() -> None:
    made = spoiled(103, "none", 8.0)
    tests = faults_of(identify(made.record, made.axis.loop), made.record).tests
    assert next(one.p_value for one in tests if one.fault is FAULTS["cogging"]) > 0.05


@pytest.mark.slow
def test_a_joint_that_has_its_ripple_is_asked_for_no_other() -> None:
    made = spoiled(103, "cogging", 8.0)
    joint = replace(made.axis.loop.joint, ripple=PositionHarmonics(made.truth["pitch"]))
    loop = replace(made.axis.loop, joint=joint)
    check = faults_of(identify(made.record, loop), made.record)
    assert FAULTS["cogging"] not in {one.fault for one in check.tests}
