"""Drive-side identification where the truth is known: recovery, lags, and intervals."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.methods import drive_side
from jointid.estimation.methods.drive_side import motion_problem
from jointid.estimation.parameters import log_delay
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.paper.twin import CONTROLLERS, TABLE_2, twin
from jointid.records.record import Channel, Injection, Record, Timing
from jointid.simulation.loop_input import prepare

JOINT = ji.FlexibleJoint("prismatic")
PHYSICAL = ("motor_inertia", "stiffness", "load_inertia")
FILTERING = ji.Filtering(cutoff=60.0)


@pytest.mark.slow
def test_a_record_without_noise_gives_the_truth_from_no_start() -> None:
    made = twin("L19", noise="none")
    record = made.record.without("reference", "injected")
    estimate = ji.identify(record, JOINT, ji.DriveSideFit(), filtering=FILTERING)
    for p in JOINT.parameters:
        assert estimate[p.name].value == pytest.approx(made.truth[p.name], rel=2e-3), p.name
    for name in PHYSICAL:
        assert estimate[name].value == pytest.approx(made.truth[name], rel=5e-4), name
    assert estimate["log_delay"].value == pytest.approx(0.0, abs=1e-6)
    assert estimate.fit.converged
    assert estimate.fit.simulations < 150


@pytest.mark.slow
def test_a_delay_before_the_torque_is_found_without_the_controller() -> None:
    record = twin("L30", noise="none").record  # a command that acts one period later
    estimate = ji.identify(record, JOINT, ji.DriveSideFit(), filtering=FILTERING)
    assert estimate["log_delay"].value == pytest.approx(-1e-3, abs=2e-6)


def test_the_spring_of_a_long_record_is_searched_along_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    def search(problem: ClosedLoopProblem, *_: object) -> None:
        raise ji.MethodError(str(len(problem.measured)))

    monkeypatch.setattr(drive_side, "search_spring", search)
    record = twin("L19", noise="none").record.without("reference", "injected")
    for times, size in ((1, "24000"), (5, "[67]....")):
        channels = {name: replace(one, values=np.tile(one.values, times)) for name, one in record.items()}
        with pytest.raises(ji.MethodError, match=f"^{size}$"):
            ji.identify(record.with_channels(channels), JOINT, ji.DriveSideFit(), filtering=FILTERING)


def test_an_inertia_whose_interval_holds_0_is_said_to_be_unknown() -> None:
    """A rigid joint that is light, slow and noisy; with little noise its inertia is told."""
    joint = ji.RigidJoint("prismatic")
    loop = ji.ClosedLoop(joint, ji.controller.Cascade(position_gain=50.0, velocity_gain=1000.0))
    truth = {"inertia": 2.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=0.2, travel=0.4, sample_time=1e-3)
    random = np.random.default_rng(3).standard_normal(reference.size)
    for noise, told in ((0.1, True), (40.0, False)):
        record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise * random)
        found = ji.identify(record.without("reference"), joint, ji.DriveSideFit(log_delay=0.0))
        assert found["inertia"].value is not None
        least = {name: found[name].interval[0] for name in ("inertia", "viscous")}
        assert (least["inertia"] > 0) is told
        assert least["viscous"] > 0


@pytest.mark.slow
def test_a_load_that_sticks_is_identified() -> None:
    truth = TABLE_2 | {"load_coulomb": 45.0}
    loop = ji.ClosedLoop(JOINT, CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids((0.083, 0.125), 0.83, 0.2, 1e-3, rest=0.3)
    known = ji.excitation.pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=1)
    driven = Record(reference=Channel(reference, "m", 1e-3), injected=Injection(Channel(known, "N", 1e-3, Timing.HELD)))
    run = ji.simulate(loop, prepare(loop, driven), truth)
    assert run.load_velocity is not None
    assert np.mean(run.load_velocity == 0) > 0.05
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3, injected=known)
    record = record.without("load_position", "reference", "injected")
    filtering = ji.Filtering(cutoff=60.0, position_cutoff=300.0)
    estimate = ji.identify(record, JOINT, ji.DriveSideFit(), filtering=filtering)
    for name, value in truth.items():
        assert estimate[name].value == pytest.approx(value, rel=2e-3), name


def test_the_slopes_of_the_residual_are_those_of_differences() -> None:
    record = twin("L19", noise="none").record.without("injected")
    problem = motion_problem([record], JOINT, FILTERING, JOINT.parameters, log_delay(None, 1e-3))
    around = {"log_delay": 3.3e-4, "initial_load_position": 1e-5, "initial_load_velocity": 1e-3}
    x = problem.vector(TABLE_2 | around)
    _, J = problem.linearise(x)
    for i, p in enumerate(problem.free):
        step = np.zeros(x.size)
        step[i] = 1e-5 * abs(x[i]) or 1e-7
        slope = (problem.residual(x + step) - problem.residual(x - step)) / (2 * step[i])
        assert np.linalg.norm(slope - J[:, i]) <= 2e-4 * np.linalg.norm(slope), p.name


def test_a_rigid_joint_needs_no_load() -> None:
    joint, truth = ji.RigidJoint("prismatic"), {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    loop = ji.ClosedLoop(joint, CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids(speeds=(0.05, 0.12), acceleration=0.83, travel=0.2, sample_time=1e-3, rest=0.4)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    estimate = ji.identify(record.without("reference"), joint, ji.DriveSideFit())
    for name, value in truth.items():
        assert estimate[name].value == pytest.approx(value, rel=2e-3), name
    assert any("rests in" in warning for warning in estimate.warnings)
    with pytest.raises(ji.MethodError, match="DRIVE_SIDE"):
        ji.intervals(estimate, record)
