"""Known truths: what the estimators must recover, and what they must refuse."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.methods.idim import IDIM
from jointid.models.controllers import PD, Cascade
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.records.record import Channel, Record, Tap, Timing
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate, simulated_record
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER

T = 1e-3
TRUTH = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
MOVING = trapezoids((0.042, 0.083, 0.125), 0.83, 0.1, T, duration=8.0)
RESTING = trapezoids((0.042, 0.083, 0.125), 0.83, 0.1, T, rest=0.6, duration=12.0)
LOOP = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)


def errors(estimate_values: dict[str, float], truth: dict[str, float]) -> float:
    return max(abs(estimate_values[name] / value - 1) for name, value in truth.items() if value)


@pytest.mark.parametrize("motion", [MOVING, RESTING], ids=["moving", "resting"])
def test_didim_recovers_a_rigid_truth(motion: np.ndarray) -> None:
    made = simulated_record(LOOP, motion, TRUTH, sample_time=T).without("motor_position")
    estimate = identify(made, LOOP)
    assert errors(estimate.values, TRUTH) <= 1e-6
    assert estimate.fit.converged


@pytest.mark.parametrize("delay", [0.4e-3, 1.3e-3])
def test_didim_recovers_the_truth_behind_a_fractional_delay(delay: float) -> None:
    late = Cascade(
        position_gain=100.0, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, limit=10.0, delay=delay
    )
    loop = ClosedLoop(RigidJoint("prismatic"), late)
    made = simulated_record(loop, MOVING, TRUTH, sample_time=T).without("motor_position")
    assert errors(identify(made, loop).values, TRUTH) <= 1e-6
    undelayed = replace(loop, controller=replace(late, delay=0.0))
    assert errors(identify(made, undelayed).values, TRUTH) > 1e-3


@pytest.mark.parametrize(("limit", "share"), [(3.4, 0.007), (3.0, 0.06)])
def test_didim_recovers_the_truth_through_saturation(limit: float, share: float) -> None:
    """At its limit the torque does not answer to the parameters, so the regressor is not the Jacobian there."""
    tight = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, limit=limit)
    loop = ClosedLoop(RigidJoint("prismatic"), tight)
    made = simulated_record(loop, MOVING, TRUTH, sample_time=T).without("motor_position")
    assert np.mean(np.abs(made.torque.values) >= limit * 35.15 * (1 - 1e-12)) > share
    assert errors(identify(made, loop).values, TRUTH) <= 1e-6


def test_didim_recovers_the_initial_state() -> None:
    start = Initial(position=2e-4, velocity=0.03)
    made = simulated_record(LOOP, MOVING, TRUTH, sample_time=T, initial=start).without("motor_position")
    estimate = identify(made, LOOP)
    assert errors(estimate.values, TRUTH) <= 1e-6
    assert estimate["initial_position"].value == pytest.approx(2e-4, rel=1e-5)
    assert estimate["initial_velocity"].value == pytest.approx(0.03, rel=1e-5)
    log = 2.0 * np.random.default_rng(3).standard_normal(len(MOVING))
    noisy = simulated_record(LOOP, MOVING, TRUTH, sample_time=T, torque_noise=log)
    assert identify(noisy, LOOP).fit.simulations < 50  # a motion that noise hides is not searched to the end


def test_didim_recovers_asymmetric_friction_on_a_rotary_pd_loop() -> None:
    truth = {
        "inertia": 0.02, "viscous_forwards": 0.05, "coulomb_forwards": 0.3, "viscous_backwards": 0.08,
        "coulomb_backwards": 0.2,
    }  # fmt: skip
    loop = ClosedLoop(RigidJoint("revolute", Friction("asymmetric")), PD(position_gain=60.0, derivative_gain=1.6))
    motion = trapezoids((2.0, 5.0, 9.0), 60.0, 4.0, T, rest=0.1)
    made = simulated_record(loop, motion, truth | {"offset": 0.0}, sample_time=T).without("motor_position")
    estimate = identify(made, loop)
    assert errors(estimate.values, truth) <= 1e-6
    assert estimate["inertia"].unit == "kg m2"
    assert estimate["viscous_forwards"].unit == "N m s/rad"


def test_a_fixed_parameter_keeps_its_value_and_a_wrong_one_biases_the_others() -> None:
    made = simulated_record(LOOP, MOVING, TRUTH, sample_time=T)
    right = {"offset": Parameter("offset", "offset", Quantity.FORCE).fix(-3.2)}
    estimate = identify(made, LOOP, parameters=right)
    assert estimate.values["offset"] == -3.2
    assert estimate["offset"].stderr is None
    assert errors(estimate.values, TRUTH) <= 1e-6
    idim = identify(made, LOOP, IDIM(), parameters=right)
    assert idim.values["offset"] == -3.2
    wrong = {"viscous": Parameter("viscous", "Fv", Quantity.VISCOUS).fix(100.0)}
    assert errors(identify(made, LOOP, parameters=wrong).values, TRUTH) > 0.01


@pytest.mark.parametrize("delay", [*(pytest.param(one, marks=pytest.mark.slow) for one in (0.5e-3, 1e-3)), 1.3e-3])
@pytest.mark.parametrize("timing", [Timing.HELD, Timing.AVERAGED])
def test_a_measured_torque_is_read_when_it_acts(delay: float, timing: Timing) -> None:
    """Held or averaged, behind a delay of whole or broken periods, by both methods."""
    late = Cascade(position_gain=100.0, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, delay=delay)
    loop = ClosedLoop(RigidJoint("prismatic"), late)
    made = simulated_record(loop, MOVING, TRUTH, sample_time=T)
    driven = Record(torque=Channel(np.zeros(MOVING.size), "N", T, timing), tap=Tap.MEASURED, reference=made.reference)
    run = simulate(loop, prepare(loop, driven), TRUTH)
    record = Record(
        torque=Channel(run.torque, "N", T, timing),
        tap=Tap.MEASURED,
        reference=made.reference,
        motor_position=Channel(run.motor_position, "m", T),
    )
    assert errors(identify(record, loop, IDIM()).values, TRUTH) < 2e-3
    assert errors(identify(record.without("motor_position"), loop).values, TRUTH) <= 1e-5


def test_an_injected_signal_that_the_log_lacks_is_added() -> None:
    known = pulses(MOVING.size, T, 60.0, 0.02, 0.3, seed=2)
    made = simulated_record(LOOP, MOVING, TRUTH, sample_time=T, injected=known, in_torque=False)
    assert errors(identify(made, LOOP, IDIM()).values, TRUTH) < 2e-3
    assert errors(identify(made, LOOP).values, TRUTH) <= 1e-6
    assert errors(identify(replace(made, injected=None), LOOP, IDIM()).values, TRUTH) > 0.01


def test_an_axis_at_rest_is_not_taken_to_move_for_the_sake_of_noise() -> None:
    clean = simulated_record(LOOP, RESTING, TRUTH, sample_time=T)
    for seed in range(2):
        noise = 4.0 * np.random.default_rng(seed).standard_normal(RESTING.size)
        torque = Channel(clean.torque.values + noise, "N", T, Timing.HELD)
        estimate = identify(Record(torque=torque, reference=clean.reference), LOOP)
        assert not estimate["initial_velocity"].free
        assert estimate["initial_velocity"].value == 0.0
        assert estimate.fit.converged


def test_a_parameter_beyond_its_bound_is_kept_there_and_said() -> None:
    made = simulated_record(LOOP, MOVING, TRUTH, sample_time=T)
    inertia, viscous, *_ = LOOP.joint.parameters
    high = identify(made, LOOP, IDIM(), parameters={"inertia": replace(inertia, lower=100.0)})
    assert high.values["inertia"] == 100.0
    assert not high["inertia"].free
    assert high["inertia"].at_bound == 100.0
    low = identify(made, LOOP, IDIM(), parameters={"viscous": replace(viscous, upper=150.0)})
    assert low.values["viscous"] == 150.0
    assert low.values["coulomb"] > TRUTH["coulomb"] + 1.0  # it takes what the other may not


def test_least_squares_ends_at_a_bound_and_says_so() -> None:
    """At one that is stated, and at 0 where a friction comes out negative."""
    made, odd = (simulated_record(LOOP, MOVING, TRUTH | more, sample_time=T) for more in ({}, {"viscous": -20.0}))
    stated = {"inertia": replace(LOOP.joint.parameters[0], lower=100.0)}
    for found, name, bound in (
        (identify(made, LOOP, parameters=stated), "inertia", 100.0),
        (identify(odd, LOOP), "viscous", 0.0),
    ):
        assert found[name].value == pytest.approx(bound, rel=1e-9, abs=1e-9)
        assert found[name].at_bound == bound
        (check,) = (check for check in found.checks if check.name == "bounds")
        assert (check.passed, check.values) == (False, {"parameters": [name]})


def test_torque_alone_in_ampere() -> None:
    joint = RigidJoint("revolute", torque_unit="A")
    truth = {"inertia": 0.01, "viscous": 0.02, "coulomb": 0.2, "offset": 0.05}
    loop = ClosedLoop(joint, PD(position_gain=40.0, derivative_gain=1.0))
    made = simulated_record(loop, trapezoids((2.0, 6.0), 50.0, 4.0, T), truth, sample_time=T)
    estimate = identify(made, loop)
    assert errors(estimate.values, truth) <= 1e-6
    assert estimate["inertia"].unit == "A s2/rad"
    assert FlexibleJoint("revolute", torque_unit="A").unit(FlexibleJoint("revolute").parameters[3]) == "A/rad"
