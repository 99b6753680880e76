"""A force that acts for a part of the time is found there, and no fault is named for it."""

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.search import find_part
from jointid.estimation.result.verdict import Reason, Subject
from studies.robot_mistakes import judge

STEP = 1e-3
LOOP = ji.ClosedLoop(
    ji.RigidJoint("revolute"), ji.controller.Cascade(position_gain=25.0, velocity_gain=2.0, integral_gain=2.0)
)
TRUTH = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.3, "offset": 0.05}
BEGIN, END = 3.0, 3.8  # s


def pushed(size: float) -> ji.Record:
    """Return the record of a joint that is pushed by so much, N m, from 3 to 3.8 s."""
    reference = ji.excitation.trapezoids((1.0, 2.0, 4.0), 40.0, 2.0, STEP, duration=8.0)
    time = STEP * np.arange(reference.size)
    push = np.where((time > BEGIN) & (time < END), size * np.sin(np.pi * (time - BEGIN) / (END - BEGIN)) ** 2, 0.0)
    noise = 0.01 * np.random.default_rng(1).standard_normal(time.size)
    made = ji.simulated_record(LOOP, reference, TRUTH, sample_time=STEP, disturbance=push, torque_noise=noise)
    return made.without("motor_position")


@pytest.mark.parametrize("size", [0.2, -0.3])
def test_a_push_is_found_in_its_part_of_the_time_and_no_fault_is_named(size: float) -> None:
    found = ji.identify(pushed(size), LOOP)
    (loop,) = (one for one in found.checks if one.name is Subject.LOOP)
    assert (loop.passed, loop.code) == (False, Reason.MISFIT_IN_PART)
    assert BEGIN - 0.1 < loop.values["begin"] < loop.values["end"] < END + 0.1
    assert not (found.answer.reliable or found.diagnosis.axes[0].faults.findings)


def test_noise_that_comes_back_is_no_part() -> None:
    assert ji.identify(pushed(0.0), LOOP).answer.reliable
    time = STEP * np.arange(8000)
    white = np.random.default_rng(0).standard_normal(time.size)
    leaned = (time > 2.0) & (time < 2.8)
    basis = (1.0 + 2.0 * leaned[:, np.newaxis]) / np.linalg.norm(1.0 + 2.0 * leaned)
    assert find_part(white, basis, time) is None
    assert find_part(white * (1.0 + 9.0 * (np.sin(2 * np.pi * time) > 0.7)), basis, time) is None
    pushed_too = white + 10.0 * leaned  # half of which the parameter follows
    found = find_part(pushed_too - basis @ (basis.T @ pushed_too), basis, time)
    assert (found.values["begin"], found.values["end"]) == pytest.approx((2.0, 2.8), abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_robot_that_is_leaned_on_has_no_other_fault(seed: int) -> None:
    assert judge(seed, "contact")[0] == ("misfit_in_part", 2)
