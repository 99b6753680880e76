"""Joints in gravity, identified: links and a vertical axis, from torque alone and from encoders, and what cannot be."""

import numpy as np
import pytest

from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.summary import remarks
from jointid.models.controllers import Cascade
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity
from jointid.records.record import Record
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.mistakes import without_positions

ARM = ClosedLoop(RigidJoint(kind="revolute", gravity=Gravity("link")), Cascade(position_gain=20.0, velocity_gain=150.0))
ARM_TRUTH = {
    "inertia": 3.0, "viscous": 4.0, "coulomb": 3.0, "offset": 0.5, "gravity_cos": 40.0, "gravity_sin": 15.0,
}  # fmt: skip

# A link behind a gear of 100:1, everything seen by the motor: 18 kg m2, 70 N m, and a counterbalance of 20 N m.
GEARED = FlexibleJoint(kind="revolute", gravity=Gravity("link", Counterbalance(cos=0.2), angle=0.01))
GEARED_LOOP = ClosedLoop(GEARED, Cascade(position_gain=40.0, velocity_gain=0.226))
GEARED_TRUTH = {
    "motor_inertia": 1.2e-3, "motor_viscous": 1.5e-3, "motor_coulomb": 0.08, "stiffness": 17.77, "damping": 6.8e-3,
    "load_inertia": 1.8e-3, "load_viscous": 1.0e-3, "load_coulomb": 0.06, "offset": 0.01, "gravity_cos": 0.7,
    "gravity_sin": -0.25, "counterbalance_cos": 0.2,
}  # fmt: skip
SAG = -0.5 / (40.0 * 0.226)  # where a proportional loop carries the load at the first sample

LIFT = ClosedLoop(
    FlexibleJoint("prismatic", gravity=Gravity("constant", Counterbalance(constant=100.0))),
    Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=35.15, limit=1e3),
)
LIFT_TRUTH = {
    "motor_inertia": 70.0, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 8e5, "damping": 126.0,
    "load_inertia": 35.0, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": 0.0, "gravity_constant": 343.0,
    "counterbalance_constant": 100.0,
}  # fmt: skip


def arm(travel: float = 2.0, noise: float = 0.0, seed: int = 0) -> Record:
    speeds = (0.5 * travel, travel) if travel >= 1 else (0.1, 0.2)
    reference = trapezoids(speeds, 4.0 * max(speeds), travel, 1e-3, rest=0.2, duration=8.0)
    white = noise * np.random.default_rng(seed).standard_normal(reference.size)
    return simulated_record(ARM, reference, ARM_TRUTH, sample_time=1e-3, torque_noise=white)


def geared(noise: float = 0.0, seed: int = 0, initial: Initial | None = None, slow: bool = False) -> Record:
    speeds, duration = ((40.0, 80.0), 16.0) if slow else ((80.0, 150.0), 9.0)
    reference = trapezoids(speeds, 1500.0, 200.0, 1e-3, rest=0.1, duration=duration)
    known = pulses(reference.size, 1e-3, height=2.0, width=0.02, every=0.4, seed=0)
    white = noise * np.random.default_rng(seed).standard_normal(reference.size)
    return simulated_record(
        GEARED_LOOP, reference, GEARED_TRUTH, sample_time=1e-3, injected=known, torque_noise=white, initial=initial
    )


def assert_found(estimate: Estimate, truth: dict[str, float], within: float) -> None:
    for name, value in truth.items():
        found = estimate[name].value
        assert abs(found - value) <= within * abs(value), (name, found, value)


def assert_covered(estimate: Estimate, truth: dict[str, float], sigmas: float = 3.5) -> None:
    for name, value in truth.items():
        found = estimate[name]
        if found.free:
            assert abs(found.value - value) < sigmas * found.stderr, name


@pytest.mark.slow
def test_a_rigid_link_from_torque_alone() -> None:
    assert_found(identify(without_positions(arm()), ARM), ARM_TRUTH, 1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_intervals_of_a_rigid_link_hold_the_truth(seed: int) -> None:
    estimate = identify(without_positions(arm(noise=1.0, seed=seed)), ARM)
    assert_covered(estimate, ARM_TRUTH)
    assert estimate["gravity_cos"].stderr < 0.002 * ARM_TRUTH["gravity_cos"]


@pytest.mark.slow
@pytest.mark.parametrize("start", [None, Initial(SAG)], ids=["falling", "hanging"])
def test_a_flexible_link_behind_a_gear_from_torque_alone(start: Initial | None) -> None:
    """A load that begins where it hangs is found there: friction would hold a motor that is begun beside it."""
    assert_found(identify(without_positions(geared(initial=start)), GEARED_LOOP), GEARED_TRUTH, 1e-6)


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_the_intervals_of_a_flexible_link_hold_the_truth(seed: int) -> None:
    estimate = identify(without_positions(geared(0.05, seed, Initial(SAG))), GEARED_LOOP)
    assert_covered(estimate, GEARED_TRUTH)
    stiffness = estimate["stiffness"]
    assert stiffness.stderr < 0.01 * GEARED_TRUTH["stiffness"]


def test_a_vertical_axis_from_torque_alone() -> None:
    reference = trapezoids((0.083, 0.125), 0.83, 0.2, 1e-3, duration=8.4)
    known = pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=1)
    record = simulated_record(LIFT, reference, LIFT_TRUTH, sample_time=1e-3, injected=known)
    estimate = identify(without_positions(record), LIFT)
    assert_found(estimate, LIFT_TRUTH, 1e-6)
    assert [p.name for p in estimate.rows if not p.free][:2] == ["offset", "counterbalance_constant"]


def test_a_link_from_encoders() -> None:
    assert_found(identify(geared(), GEARED_LOOP, IDIM()), GEARED_TRUTH | {"offset": 0.01}, 0.01)
    assert_found(identify(arm(), ARM, IDIM()), {"gravity_cos": 40.0, "gravity_sin": 15.0}, 0.01)


@pytest.mark.parametrize("travel", [0.2, 0.05])
def test_a_short_travel_tells_only_sums(travel: float) -> None:
    """Over a few degrees the cosine is a constant and the sine a straight line: both estimators say so."""
    record = arm(travel, noise=0.3)
    estimate = identify(without_positions(record), ARM)
    pairs = [one.values["parameters"] for one in estimate.checks if one.code == "inseparable" and not one.passed]
    assert ["offset", "gravity_cos"] in pairs
    total = estimate.values["offset"] + estimate.values["gravity_cos"]
    std = estimate.covariance_of(["offset", "gravity_cos"]).std_of(np.ones(2))
    assert total == pytest.approx(40.5, abs=6.0 * std)
    assert std < 0.01
    assert_covered(estimate, ARM_TRUTH, 4.0)
    told_of = [remarks(identify(one, ARM, IDIM())) for one in (record, arm())]
    assert ["only with" in one.get("gravity_cos", "") for one in told_of] == [True, False]
