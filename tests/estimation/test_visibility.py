"""A stiffness is reported where the record shows it, and refused, with a bound, where it does not."""

import json

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.common.messages import ignore_progress
from jointid.diagnostics.validation import validate
from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.springs import visible
from jointid.estimation.result.verdict import told_bounds
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.output.json import dumps, to_dict
from jointid.paper.twin import twin
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.synthesis import simulated_record
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty
from studies.mechanics import spoiled
from studies.stiffness_bounds import random_plant
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER

LOOP = ClosedLoop(FlexibleJoint("prismatic"), CONTROLLER)


def stiffness_verdict(estimate: Estimate) -> tuple[bool | None, str]:
    found = [check for check in estimate.checks if check.name == "stiffness"]
    return found[0].passed, "; ".join(check.words for check in found)


PLANT = random_plant(13)


@pytest.fixture(scope="module")
def unseen() -> tuple[Record, Estimate]:
    """A drive whose spring its record does not show, and its estimate from torque and reference."""
    reference, torque = PLANT.record.reference.values, PLANT.record.torque.values
    noise = 0.05 * np.std(torque) * np.random.default_rng(1).standard_normal(torque.size)
    record = simulated_record(
        PLANT.loop, reference, PLANT.truth, sample_time=1e-3, torque_noise=noise, encoder_step=1e-6
    )
    return record, ji.identify(record.without("motor_position", "load_position"), PLANT.loop)


def test_a_spring_that_the_record_does_not_show_is_refused(unseen: tuple[Record, Estimate]) -> None:
    record, estimate = unseen
    assert stiffness_verdict(estimate)[0] is False
    assert {estimate[name].value for name in ("motor_inertia", "load_inertia", "stiffness", "damping")} == {None}
    bounds = {bound.share: bound.stiffness for bound in estimate.bounds}
    assert 0.1 * PLANT.truth["stiffness"] < bounds[PLANT.share] < PLANT.truth["stiffness"]
    whole = {known.combination.name: known for known in estimate.known.physical}
    inertia = PLANT.truth["motor_inertia"] + PLANT.truth["load_inertia"]
    assert whole["total inertia"].value == pytest.approx(inertia, rel=0.05)
    assert json.loads(dumps(to_dict(estimate)))["parameters"]["stiffness"]["value"] is None
    with pytest.raises(MethodError, match=r"stiffness, .*cannot be determined from this record"):
        validate(estimate, record)
    assert estimate.checks[-1].code == "loop_as_declared"
    assert told_bounds(estimate) == estimate.bounds


@pytest.mark.slow
def test_the_loop_and_the_log_of_a_refused_spring_are_checked() -> None:
    """Without that check, the whole inertia is 9 % off, 7.9 deviations, and nothing is said."""
    made = spoiled(270304, "saturation", 4.0, "white force")
    assert made is not None
    estimate = ji.identify(made.record, made.axis.loop)
    assert stiffness_verdict(estimate)[0] is False
    assert estimate.answer.trust.code == "not_reliable_yet"
    assert estimate.checks[-1].values["suspect"] == "torque_saturation"
    assert told_bounds(estimate) == ()


@pytest.mark.slow
def test_the_emps_axis_shows_no_spring(emps: Record) -> None:
    """What Coulomb's law lacks here is explained better by a load's friction that lags behind a spring, from 40 Hz on.

    With that friction on the motor's side the bounds would be three times as high.
    """
    estimate = identify(emps.without("motor_position"), LOOP)
    assert stiffness_verdict(estimate)[0] is False
    bounds = [bound.stiffness or 0.0 for bound in estimate.bounds]
    assert bounds == sorted(bounds)
    assert 0.1e6 <= bounds[0] <= 4e6
    assert bounds[-1] >= 2e6
    whole = {known.combination.quantity: known.value for known in estimate.known.physical}
    assert whole["inertia"] == pytest.approx(95.0, abs=1.5)


@pytest.mark.parametrize("held", ["motor", "load"])
def test_a_mass_that_its_friction_holds_tells_no_inertia(held: str) -> None:
    """Its inertia moves nothing in the torque: a descent leaves it where it began, were it at 12,000 kg."""
    axis = twin(noise="none")
    truth = {**axis.truth, f"{held}_coulomb": 1e4, f"{held}_inertia": 12e3}
    reference = 2e-4 * np.sin(2 * np.pi * 3.0 * np.arange(700) * 1e-3)
    noise = np.random.default_rng(0).standard_normal(reference.size)
    record = simulated_record(axis.loop, reference, truth, sample_time=1e-3, torque_noise=noise)
    problem = torque_problem(record, axis.loop, Filtering(), axis.loop.joint.parameters)
    problem = problem.keeping({"initial_velocity": 0.0})
    x = problem.vector({"initial_position": 0.0, "initial_torque": 0.0} | truth)
    error, J = problem.linearise(x)
    assert not J[:, [p.name for p in problem.free].index(f"{held}_inertia")].any()
    known = uncertainty(Influence(J, error), problem.cells(problem.simulate(x)))
    found = visible(problem, x, J, known, (2, 2), ignore_progress, (0.5,))
    assert not found.shown and not {*found.std} & {*axis.truth}  # also where the rigid joint leaves more than 15 %
    assert held == "load" or found.bounds[0].stiffness is None  # where nothing moves, no spring is excluded
    other = problem.with_log(measured=2.0 * problem.log.measured)
    assert found.bounds and not visible(other, x, J, known, (2, 2), ignore_progress).bounds  # which no joint explains
    assert any(f"the {held} never moves" in check.words for check in found.checks)
