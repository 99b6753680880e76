"""The public EMPS axis: the published results to every digit, and torque-only identification."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.diagnostics.validation import validate
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER

LOOP = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
ASYMMETRIC = ClosedLoop(RigidJoint("prismatic", friction=Friction("asymmetric")), CONTROLLER)


def rounded(estimate: Estimate, digits: dict[str, int]) -> dict[str, float]:
    return {name: round(estimate.values[name], places) for name, places in digits.items()}


def test_idim_repeats_the_published_results_to_every_digit(emps: Record, emps_pulses: Record) -> None:
    estimate = identify(emps, LOOP, IDIM(), filtering=Filtering.published())
    digits = {"inertia": 4, "viscous": 4, "coulomb": 4, "offset": 4}
    expected = {"inertia": 95.1089, "viscous": 203.5034, "coulomb": 20.3935, "offset": -3.1648}
    assert rounded(estimate, digits) == expected
    assert round(100 * estimate.fit.filtered_error, 4) == 4.0834
    assert round(estimate.fit.conditioning["raw"], 4) == 25.9883
    cross = validate(estimate, emps_pulses)
    assert cross.test == "cross"
    assert round(100 * cross.filtered_error, 4) == 5.9824


def test_idim_repeats_the_published_asymmetric_results(emps: Record) -> None:
    estimate = identify(emps, ASYMMETRIC, IDIM(), filtering=Filtering.published())
    digits = {"inertia": 3, "viscous_forwards": 2, "coulomb_forwards": 2}
    digits |= {"viscous_backwards": 2, "coulomb_backwards": 2}
    assert rounded(estimate, digits) == {
        "inertia": 95.154, "viscous_forwards": 166.71, "coulomb_forwards": 20.14, "viscous_backwards": 240.42,
        "coulomb_backwards": 20.63,
    }  # fmt: skip
    assert round(100 * estimate.fit.filtered_error, 4) == 3.1117


def test_idim_with_the_timing_respected(emps: Record) -> None:
    """The held torque acts half a period later than it is stamped: 4 N s/m of viscous friction were its lag.

    Through one window for torque and motion IDIM comes within 0.3 of its deviations of torque-only DIDIM.
    """
    estimate = identify(emps, LOOP, IDIM())
    assert rounded(estimate, {"inertia": 2, "viscous": 2, "coulomb": 2}) == {
        "inertia": 95.01, "viscous": 206.28, "coulomb": 20.22,
    }  # fmt: skip


def test_didim_identifies_the_axis_from_torque_and_reference_only(emps: Record) -> None:
    estimate = identify(emps.without("motor_position"), LOOP)
    assert estimate.values["inertia"] == pytest.approx(95.0, abs=0.5)
    assert estimate.values["viscous"] == pytest.approx(207.5, abs=5)
    assert estimate.values["coulomb"] == pytest.approx(20.1, abs=0.5)
    assert estimate.values["offset"] == pytest.approx(-3.2, abs=0.1)
    assert estimate.fit.converged
    assert estimate.settings.method == "didim"
    assert estimate.data.channels == ("torque", "reference")
    assert estimate.fit.relative_error <= 0.046
    assert estimate["initial_velocity"].value == pytest.approx(0.007, abs=0.001)


def test_two_records_agree_within_their_intervals(emps: Record, emps_pulses: Record) -> None:
    """They are wide enough for what repeats with the motion, and say so; those of a white residual do not agree."""
    first, second = (identify(record, LOOP) for record in (emps, emps_pulses))
    for name in ("inertia", "viscous", "coulomb", "offset"):
        gap = abs(first.values[name] - second.values[name])
        assert gap <= 2 * float(np.hypot(first[name].stderr or 0.0, second[name].stderr or 0.0)), name
    # 1.3 kg apart: what Coulomb's law lacks, which the solution by the regressor weighs otherwise, is in the intervals.
    assert abs(first.values["inertia"] - second.values["inertia"]) > 1.0
    assert 0.3 < float(first["inertia"].stderr or 0.0) < 0.7
    (repeats,) = (v for v in first.checks if v.name == "repeatable residual")
    assert not repeats.passed


def test_each_of_several_records_has_the_interval_that_it_has_alone(emps: Record, emps_pulses: Record) -> None:
    """What the solution by the regressor widens is one rule; the common interval counts it as each record weighs."""
    alone = [identify(record, LOOP)["inertia"].stderr or 0.0 for record in (emps, emps_pulses)]
    together = identify([emps, emps_pulses], LOOP)
    shares = [part.std["inertia"] for part in together.agreement.parts]
    assert shares == pytest.approx(alone, rel=0.02)
    assert min(alone) < 1.2 * float(together["inertia"].stderr or 0.0) < 1.2 * max(alone)


def test_a_gain_that_was_forgotten_is_thought_of(emps: Record) -> None:
    volts = replace(emps, torque=replace(emps.torque, values=emps.torque.values / CONTROLLER.gain))
    with pytest.raises(
        MethodError, match=r"inertia 2\.8.* loop is not stable.*check the sign, gain and unit of the torque"
    ):
        identify(volts, LOOP, DIDIM())
