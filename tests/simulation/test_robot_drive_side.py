"""Robots whose motors move as prescribed: torques as in the loop that moved them, and how they change."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.inverse_model import moving_weights
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint
from jointid.records.signals.filtering import window_parts
from jointid.simulation.drive_side import DriveSideRun, PrescribedMotion, prescribe, run_drive_side
from jointid.simulation.plant import LOAD_STATE, Numbers, Place
from jointid.simulation.simulate import Outcome, Simulation, motion_of
from jointid.simulation.synthesis import simulate
from tests.robots_plants import Twin, all_places, inertial, six, two, with_springs
from tests.simulation.differences import drive_side_slopes
from tests.simulation.test_robots import COUPLED, changed


def played(twin: Twin, duration: float = 3.0) -> Simulation:
    """Return a twin in its loops, in steps that leave no error beside that of the drive side."""
    return simulate(twin.loop(), twin.records(duration, multisine=0.004), steps=6)


def prescribed(robot: Robot, run: Simulation, parts: int = 1, first: int = 0) -> PrescribedMotion:
    resting = np.full(len(robot), first == 0)
    return prescribe(run.motor_position[first:], run.sample_time, parts, robot.tree, resting)


def places_of(found: DriveSideRun) -> FloatArray:
    """Return the positions of all masses at the ends of the parts."""
    return motion_of(found.tape, found.numbers.count, len(found.torque) + 1)[0]


def error(found: DriveSideRun, run: Simulation, parts: int = 1, first: int = 0) -> FloatArray:
    """Return the error of each joint's torque, rms, as a share, but where a motor rests or turns round."""
    curved = found.torque.copy()
    curved[1:-1] -= np.diff(found.torque, 2, axis=0) / 12.0
    seen, logged = window_parts(curved, parts, 0.0), window_parts(run.torque[first:-1], 1, 0.0)
    moving = np.column_stack([moving_weights(v, turning=True) for v in run.motor_velocity[first:].T])
    left = ((seen - logged) * moving)[600:-20]  # the twin's first 0.6 s begin with a jolt, which is no smooth motion
    return np.asarray(np.sqrt(np.mean(left**2, axis=0)) / np.std(logged, axis=0))


@pytest.mark.parametrize(
    "twin",
    [
        two((12.0, 18.0)),
        two((12.0, None)),
        two((None, 18.0)),
        changed(two((12.0, 18.0)), *COUPLED),
        pytest.param(six((True, True, False, True, False, True)), marks=pytest.mark.slow),
    ],
    ids=["flexible", "rigid second", "rigid first", "coupled motors", "six"],
)
def test_the_torque_is_that_of_the_loop_that_moved_the_motors(twin: Twin) -> None:
    run = played(twin)
    numbers = Numbers.of(twin.robot)
    found = run_drive_side(prescribed(twin.robot, run), numbers)
    assert found.outcome is Outcome.FINISHED
    # What a link that begins to stick does to the motor of a rigid joint is a jump within a sample.
    bounds = np.where(numbers.flexible, 2e-4, 1e-3)
    assert np.all(error(found, run) < bounds)
    # Springs that are a hundredth stiffer are seen.
    stiffer = with_springs(numbers, 1.01)
    assert np.max(error(run_drive_side(prescribed(twin.robot, run), stiffer), run)) > 2e-3


def test_where_the_motors_are_at_the_ends_of_the_parts_is_right_to_the_fourth_order() -> None:
    twin = two((12.0, 18.0))
    run, numbers, off = played(twin), Numbers.of(twin.robot), []
    for parts in (1, 2, 4):
        found = run_drive_side(prescribed(twin.robot, run, parts), numbers)
        there = places_of(found)[::parts, numbers.motors]
        off.append(float(np.max(np.abs(there[600:] - run.motor_position[600:]))))
    assert off[0] < 1e-6
    assert off[0] / off[1] > 10.0
    assert off[1] / off[2] > 10.0


def test_a_record_may_begin_in_motion() -> None:
    """With the links where they were at its first sample; from steady motion their swing would be missed."""
    twin, first = two((12.0, 18.0)), 1000
    run, numbers = played(twin), Numbers.of(twin.robot)
    motion = prescribed(twin.robot, run, first=first)
    steady = run_drive_side(motion, numbers)
    beside = np.column_stack(
        [run.load_position[first] - steady.start[:2], run.load_velocity[first] - motion.velocity[0]]
    )
    places = [Place(j, name) for j in range(2) for name in LOAD_STATE]
    found = run_drive_side(motion, numbers.with_values(places, beside.ravel()))
    at = places_of(found)[: len(run.load_position) - first, :2]
    assert at == pytest.approx(run.load_position[first:], abs=3e-6)
    lost = places_of(steady)[:500, :2] - run.load_position[first : first + 500]
    assert np.max(np.abs(lost)) > 1e-4


@pytest.mark.parametrize(
    "hertz",
    [(12.0, None), *(pytest.param(one, marks=pytest.mark.slow) for one in ((12.0, 18.0), (None, 12.0)))],
    ids=["rigid second", "flexible", "rigid first"],
)
def test_derivatives_are_those_of_differences(hertz: tuple[float | None, float | None]) -> None:
    twin = two(hertz)
    run = played(twin, 1.0)
    first = [Place(int(i), LOAD_STATE[0]) for i in np.flatnonzero(Numbers.of(twin.robot).flexible)]
    numbers = Numbers.of(twin.robot).with_values(first, np.zeros(len(first)))
    motion = prescribed(twin.robot, run, parts=4)
    places = (*all_places(numbers), *first)
    found = run_drive_side(motion, numbers)
    slopes = drive_side_slopes(found, places)
    sizes = np.linalg.norm(slopes, axis=(0, 1))
    for c, place in enumerate(places):
        value = numbers[place]
        step = 1e-6 if place in first else 1e-4 * max(abs(value), 1e-2)
        ends = [run_drive_side(motion, numbers.with_values((place,), np.array([value + d]))) for d in (step, -step)]
        difference = (ends[0].torque - ends[1].torque) / (2 * step)
        size = max(float(np.linalg.norm(difference)), 1e-6 * float(np.median(sizes)))
        assert np.linalg.norm(slopes[:, :, c] - difference) < 0.01 * size, place


def test_a_heavy_load_does_not_move_a_motor_that_is_held() -> None:
    """A minute of a robot as stiff as a real one: the weight stays what it is."""
    link = Link(
        "arm", -1, axis=np.array([0.0, 1.0, 0.0]), inertial=inertial(100.0, (1.0, 0.0, 0.0), (1.0, 110.0, 110.0))
    )
    robot = Robot((link,), (RobotJoint("arm", 10.0, spring=JointSpring(4.6e6, 1e4, 1.0, 1.0)),))
    motion = prescribe(np.zeros((15001, 1)), 4e-3, 1, robot.tree, True)
    assert run_drive_side(motion, Numbers.of(robot)).torque[[0, -1], 0] == pytest.approx(-981.0, rel=1e-5)


def test_what_cannot_be_simulated_is_said() -> None:
    twin = two((12.0, 18.0))
    motion, numbers = prescribed(twin.robot, played(twin, 1.0)), Numbers.of(twin.robot)
    for other, outcome in (
        (with_springs(numbers, -1.0), Outcome.INVALID),
        (with_springs(numbers, 1e8), Outcome.TOO_STIFF),
        (replace(numbers, inertials=-numbers.inertials), Outcome.NOT_POSITIVE),
    ):
        found = run_drive_side(motion, other)
        assert found.outcome is outcome
        assert not np.any(found.torque)
