"""The outputs of DIDIM: the torque, or the motor position through the declared controller."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.model_free import compare_law
from jointid.estimation.parameters import robot_parameters
from jointid.estimation.problems.simulated import pose_robot
from jointid.output.figures import AxisSignals
from jointid.paper.twin import twin
from jointid.records.chunks import cut
from jointid.simulation.plant import Numbers
from jointid.simulation.synthesis import simulate
from tests.estimation.robots.twin import arm, motion
from tests.robots_plants import two

SAMPLE_TIME = 2e-3
TRUTH = {"inertia": 0.5, "viscous": 0.6, "coulomb": 1.5, "offset": 0.2}
LAW = ji.controller.PD(position_gain=400.0, derivative_gain=30.0)
LOOP = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)


def logged(law: Any = LAW, truth: dict[str, float] | None = None, noise: float = 1e-4, **more: Any) -> ji.Record:
    """Return a record of a rigid joint whose encoder has white noise."""
    reference = ji.excitation.trapezoids((1.0, 3.0), 30.0, 1.0, SAMPLE_TIME, duration=12.0)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    record = ji.simulated_record(loop, reference, truth or TRUTH, sample_time=SAMPLE_TIME, **more)
    position = record.motor_position
    values = position.values + noise * np.random.default_rng(0).standard_normal(len(position))
    return replace(record, motor_position=replace(position, values=values))


def identify(record: ji.Record, law: Any = LAW, *outputs: str, **more: Any) -> ji.Estimate:
    """Identify a rigid joint under a law."""
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    return ji.identify(record, loop, ji.DIDIM(outputs=outputs), **more)


def deviations(estimate: ji.Estimate) -> list[float]:
    """Return how far values are from the truth, in deviations."""
    rows = [row for row in estimate.rows if row.name in TRUTH and row.stderr]
    return [((row.value or 0.0) - TRUTH[row.name]) / (row.stderr or 1.0) for row in rows]


def scale_status(estimate: ji.Estimate) -> list[bool | None]:
    """Return whether the check of the scale passed, if there is one."""
    return [check.passed for check in estimate.checks if check.name == "scale"]


def test_a_record_without_torque_is_identified_from_its_position() -> None:
    found = identify(logged().without("torque"))
    assert len(deviations(found)) == 4
    assert max(map(abs, deviations(found))) < 3.5
    assert found.data.channels == ("reference", "motor_position")
    assert AxisSignals.of(found).label == "torque computed from the position [N m]"
    assert scale_status(found) == [None]


@pytest.mark.slow
def test_a_common_factor_of_the_gains_is_invisible_and_moves_every_parameter() -> None:
    record = logged().without("torque")
    right, larger = identify(record), identify(record, ji.controller.PD(position_gain=480.0, derivative_gain=36.0))
    assert larger.answer.trust.code == right.answer.trust.code == "not_checked"
    for name in TRUTH:
        assert larger[name].value == pytest.approx(1.2 * right[name].value, rel=0.01)


@pytest.mark.slow
def test_a_known_parameter_or_an_injected_torque_tells_the_scale() -> None:
    kept = {"inertia": ji.RigidJoint("revolute").parameters[0].fix(0.5)}
    assert scale_status(identify(logged().without("torque"), parameters=kept)) == [True]
    record = logged(injected=ji.excitation.pulses(6000, SAMPLE_TIME, 5.0, 0.05, 0.5, 0))
    assert scale_status(identify(record.without("torque"))) == [True]


def test_a_free_gain_needs_a_known_parameter() -> None:
    record, wrong = logged().without("torque"), ji.controller.PD(position_gain=480.0, derivative_gain=36.0)
    loop, method = ji.ClosedLoop(ji.RigidJoint("revolute"), wrong), ji.DIDIM(free=("gain",))
    with pytest.raises(ji.MethodError, match="one with the scale of the joint"):
        ji.identify(record, loop, method, checks=False)
    known = {"inertia": ji.RigidJoint("revolute").parameters[0].fix(0.5)}
    found = ji.identify(record, loop, method, parameters=known, checks=False)
    assert found["gain"].value == pytest.approx(400.0 / 480.0, rel=1e-3)
    assert max(map(abs, deviations(found))) < 3.5


def test_no_fault_of_a_log_is_tested_where_no_torque_was_logged() -> None:
    """Nor is the controller compared with its own torque."""
    tests = ji.identify(logged().without("torque"), LOOP).diagnosis.axes[0].faults.tests
    assert not {"log_gain", "log_delay"} & {test.name for test in tests}
    assert compare_law(ji.controller.compute_controller_torque(logged(), LOOP), LOOP) is None


@pytest.mark.slow
def test_positions_are_of_several_records_and_of_windows() -> None:
    law = replace(LAW, period=1e-3)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    noise = 0.3 * np.random.default_rng(1).standard_normal((2, 6000))
    first = logged(law, torque_noise=noise[0])
    second = logged(law, TRUTH | {"coulomb": 1.8}, noise=-1e-4, torque_noise=noise[1])
    own = {"own": ((), ("coulomb",))}
    together = ji.identify([first, second], loop, ji.DIDIM(outputs=("motor_position",)), several=own)
    assert together["coulomb@2"].value == pytest.approx(1.8, rel=0.01)
    windows = ji.identify(first, loop, ji.DIDIM(outputs=("motor_position",)), windows=2.0)
    for found in (together, windows):
        assert "motor_position" in found.data.channels
        assert len(deviations(found)) in (3, 4) and max(map(abs, deviations(found))) < 4.0
        assert scale_status(found) == [None]
        assert found["inertia"].stderr < 2e-3


def test_an_estimate_of_the_position_is_profiled() -> None:
    found = ji.identify(logged(), LOOP, ji.DIDIM(outputs=("motor_position",)), checks=False)
    (profile,) = ji.intervals(found, logged().without("torque"))
    low, high = profile.interval
    assert low is not None and high is not None and low < 0.5 < high


@pytest.mark.parametrize("begin", [0.0, 0.6])
def test_an_integral_leaves_no_constant_torque(begin: float) -> None:
    law = ji.controller.Cascade(position_gain=15.0, velocity_gain=30.0, integral_gain=5.0)
    record = cut(logged(law).without("torque"), round(begin / SAMPLE_TIME), 6000)
    found = identify(record, law, checks=False)
    assert found["offset"].value is None
    assert max(map(abs, deviations(found))) < 3.5
    assert [v.values["undetermined"] for v in found.checks if v.name == "scale"] == [["offset"]]


def test_idim_takes_a_computed_torque() -> None:
    found = ji.identify(ji.controller.compute_controller_torque(logged().without("torque"), LOOP), LOOP, ji.IDIM())
    assert found["inertia"].value == pytest.approx(0.5, rel=0.01)
    assert scale_status(found) == [None]
    assert found.answer.trust.values["reasons"] == ["motion_measured"]
    assert f" {1e3 * found.data.sample_time:g} ms " in str(found.answer)  # which no motion tells


PDS = tuple(ji.controller.PD(position_gain=p, derivative_gain=d) for p, d in ((6000.0, 400.0), (5000.0, 350.0)))
CASCADES = tuple(ji.controller.Cascade(position_gain=15.0, velocity_gain=v, integral_gain=5.0) for v in (400.0, 350.0))


def log_robot(laws: tuple[Any, ...]) -> tuple[ji.robots.RobotLoop, list[ji.Record]]:
    """Return a robot under its controllers, and a log of its positions."""
    loop = ji.robots.RobotLoop(arm(2), laws)
    references = motion(3, 2, 6.0)[0]
    asked = [ji.Record(reference=ji.Channel(one, "rad", SAMPLE_TIME)) for one in (references - references[0]).T]
    random = np.random.default_rng(2)
    records = []
    for record in simulate(loop, asked).records(asked):
        values = record.motor_position.values + 1e-5 * random.standard_normal(len(record.motor_position))
        records.append(replace(record, torque=None, motor_position=replace(record.motor_position, values=values)))
    return loop, records


@pytest.mark.slow
def test_a_robot_under_an_integral_settles_and_has_no_offsets() -> None:
    loop, records = log_robot(CASCADES)
    found = ji.identify(records, loop, checks=False)
    assert found.fit.converged
    assert found["joint1.offset"].value is None is found["joint2.offset"].value
    for name, joint in zip(loop.robot.names, loop.robot.joints, strict=True):
        assert found[f"{name}.viscous"].value == pytest.approx(joint.viscous, rel=0.05)
        assert found[f"{name}.coulomb"].value == pytest.approx(joint.coulomb, rel=0.05)


def test_a_robot_without_torques_is_identified_from_its_positions() -> None:
    loop, records = log_robot(PDS)
    found = ji.identify(records, loop, checks=False)
    assert scale_status(found) == [None]
    assert max(found.fit.axis_errors.values()) < 0.05
    assert found["joint1.viscous"].value == pytest.approx(loop.robot.joints[0].viscous, rel=0.02)


def test_positions_of_a_robot_lower_the_cutoff_and_their_ends_are_not_compared() -> None:
    """The law differentiates the noise, and the filter holds to it at both ends."""
    twin = two()
    loop, asked, random = twin.loop(), twin.records(6.0), np.random.default_rng(3)
    computed = []
    for record, law in zip(simulate(loop, asked).records(asked), loop.controllers, strict=True):
        values = record.motor_position.values + 5e-4 * random.standard_normal(len(record.motor_position))
        noisy = record.with_channels({"motor_position": replace(record.motor_position, values=values)})
        computed.append(ji.controller.compute_controller_torque(noisy, ji.ClosedLoop(ji.RigidJoint("revolute"), law)))
    problem = pose_robot(loop, computed, robot_parameters(twin.robot))
    assert problem.filtering.cutoff is not None and problem.filtering.cutoff < 30.0
    rows = problem.by_joint(problem.error(problem.runs_of(Numbers.of(twin.robot))))
    spanned = (rows.shape[1] - 1) * (problem.filtering.decimation or 1)
    assert spanned < len(problem.measured) - sum(problem.filtering.borders)
    assert np.max(np.abs(rows)) < 6.0 * np.std(rows)


@pytest.mark.slow
@pytest.mark.parametrize("noise", ["disturbance", "white"])
def test_torque_and_position_of_the_twin_agree_within_their_intervals(noise: Any) -> None:
    made = twin("L19", noise=noise, seed=3)
    methods = [ji.DIDIM(outputs=(one,), frequency=30.0) for one in ("torque", "motor_position")]
    how = ji.Filtering(cutoff=60.0)
    torque, position = (ji.identify(made.record, made.loop, one, filtering=how, checks=False) for one in methods)
    for name, truth in made.truth.items():
        of_torque, of_position = torque[name], position[name]
        width = math.hypot(of_torque.stderr or 0.0, of_position.stderr or 0.0)
        assert abs((of_position.value or 0.0) - (of_torque.value or 0.0)) < 3.0 * width, name
        assert abs((of_position.value or 0.0) - truth) < 3.5 * (of_position.stderr or 0.0), name


def test_rows_within_the_borders_of_a_computed_torque_are_not_counted() -> None:
    """A quarter of the record at either end: half of the rows are left, and the residual's variance is theirs."""
    record, given = logged().without("torque"), [ji.Filtering(borders=(some, some)) for some in (0, 1500)]
    whole, inside = (identify(record, checks=False, filtering=one).fit.rows for one in given)
    assert 0.4 * whole < inside < 0.6 * whole
