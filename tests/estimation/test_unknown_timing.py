"""Intervals where nobody stated whether the torque is held or sampled, for a plant simulated by the study."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from studies.unknown_timing import TRUE, logged


def test_intervals_hold_the_truth_whichever_the_timing_was():
    inside, errors = [], []
    for rate in (30.0, 50.0, 100.0):
        for held in (True, False):
            for seed in range(4):
                found = ji.identify(logged(rate, held, seed), ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
                inside += [abs(found[name].value - true) <= 2 * found[name].stderr for name, true in TRUE.items()]
                errors.append(abs(found["coulomb"].value / TRUE["coulomb"] - 1))
                assert any("held or sampled" in one for one in found.checks.warnings)
    assert np.mean(inside) >= 0.85
    assert np.sqrt(np.mean(np.square(errors))) < 0.015  # 4 % with the rows about reversals


@pytest.mark.parametrize("timing", ["held", "sampled"])
def test_stated_timing_is_obeyed_and_a_wrong_one_is_said(timing):
    record = logged(200.0, False, 1, noise=0.002)
    stated = replace(record, torque=replace(record.torque, timing=timing, stated=True))
    found = ji.identify(stated, ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    said = [one for one in found.checks.warnings if "samples before held" in one]
    assert [one.startswith("the torque is stated as held") for one in said] == [True] * (timing == "held")


def test_validation_reads_a_fresh_record_as_the_estimate_did():
    fresh = logged(200.0, False, 2, noise=0.002)
    found = ji.identify(logged(200.0, False, 1, noise=0.002), ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    assert found.settings.timing == "sampled"
    errors = [
        ji.validate(found, replace(fresh, torque=replace(fresh.torque, timing=timing, stated=stated))).filtered_error
        for timing, stated in (("held", False), ("sampled", True), ("held", True))
    ]
    assert errors[0] == errors[1] < errors[2]
