"""The outputs of DIDIM: the torque, the motor position through the declared controller, or both."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.config import loads
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.model_free import compare_law
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.simulation.synthesis import simulate

SAMPLE_TIME = 2e-3
TRUTH = {"inertia": 0.5, "viscous": 0.6, "coulomb": 1.5, "offset": 0.2}
LAW = ji.controller.PD(position_gain=400.0, derivative_gain=30.0)


def logged(law: Any = LAW, truth: dict[str, float] | None = None, noise: float = 1e-4, **more: Any) -> ji.Record:
    """Return a record of a rigid joint whose encoder has white noise."""
    reference = ji.excitation.trapezoids((1.0, 3.0), 30.0, 1.0, SAMPLE_TIME, duration=12.0)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    record = ji.simulated_record(loop, reference, truth or TRUTH, sample_time=SAMPLE_TIME, **more)
    position = record.motor_position
    assert position is not None
    values = position.values + noise * np.random.default_rng(0).standard_normal(len(position))
    return replace(record, motor_position=replace(position, values=values))


def identify(record: ji.Record, law: Any = LAW, *outputs: str, **more: Any) -> ji.Estimate:
    """Identify a rigid joint under a law."""
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    return ji.identify(record, loop, ji.DIDIM(outputs=outputs), **more)


def deviations(estimate: ji.Estimate) -> list[float]:
    """Return how far values are from the truth, in deviations."""
    rows = [row for row in estimate.params.rows if row.name in TRUTH and row.stderr]
    return [((row.value or 0.0) - TRUTH[row.name]) / (row.stderr or 1.0) for row in rows]


def scale_status(estimate: ji.Estimate) -> list[str]:
    """Return the status of the verdict on the scale, if there is one."""
    return [str(verdict.status) for verdict in estimate.checks.verdicts if verdict.subject == "scale"]


def test_a_record_without_torque_is_identified_from_its_position() -> None:
    found = identify(logged().without("torque"))
    assert len(deviations(found)) == 4
    assert max(map(abs, deviations(found))) < 3.5
    assert found.data.channels == ("reference", "motor_position")
    assert scale_status(found) == ["unknown"]
    assert "if the scale of the controller's gains is right" in found.sentence


def test_a_common_factor_of_the_gains_is_invisible_and_moves_every_parameter() -> None:
    record = logged().without("torque")
    right, larger = identify(record), identify(record, ji.controller.PD(position_gain=480.0, derivative_gain=36.0))
    assert larger.answer.trust.code == right.answer.trust.code == "not_checked"
    for name in TRUTH:
        assert larger.params[name].value == pytest.approx(1.2 * right.params[name].value, rel=0.01)


def test_a_known_parameter_or_an_injected_torque_tells_the_scale() -> None:
    kept = {"inertia": ji.RigidJoint("revolute").parameters[0].fix(0.5)}
    assert scale_status(identify(logged().without("torque"), parameters=kept)) == ["passed"]
    pulses = ji.excitation.pulses(6000, SAMPLE_TIME, 5.0, 0.05, 0.5, 0)
    record = logged(injected=pulses).without("torque")
    assert scale_status(identify(record)) == ["passed"]


def test_a_signal_without_torque_and_a_speed_tell_no_scale() -> None:
    still = logged(injected=np.zeros(6000)).without("torque")
    assert scale_status(identify(still, checks=False)) == ["unknown"]
    joint = ji.RigidJoint("revolute", friction=ji.friction.StribeckFriction())
    speed = next(p for p in joint.parameters if p.name == "stribeck_speed").fix(0.3)
    found = ji.identify(
        logged().without("torque"), ji.ClosedLoop(joint, LAW), parameters={"stribeck_speed": speed}, checks=False
    )
    assert scale_status(found) == ["unknown"]


def test_a_free_gain_needs_a_known_parameter() -> None:
    record, wrong = logged().without("torque"), ji.controller.PD(position_gain=480.0, derivative_gain=36.0)
    loop, method = ji.ClosedLoop(ji.RigidJoint("revolute"), wrong), ji.DIDIM(free=("gain",))
    with pytest.raises(ji.MethodError, match="one with the scale of the joint"):
        ji.identify(record, loop, method, checks=False)
    known = {"inertia": ji.RigidJoint("revolute").parameters[0].fix(0.5)}
    found = ji.identify(record, loop, method, parameters=known, checks=False)
    assert found.params["gain"].value == pytest.approx(400.0 / 480.0, rel=1e-3)
    assert max(map(abs, deviations(found))) < 3.5


def test_no_fault_of_a_log_is_tested_where_no_torque_was_logged() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)
    found = ji.identify(logged().without("torque"), loop)
    checked = found.checks.diagnosis
    assert isinstance(checked, Diagnosis)
    assert not {"log_gain", "log_delay"} & {test.name for test in checked.axes[0].faults.tests}


def test_outputs_that_contradict_each_other_are_not_averaged() -> None:
    record = logged(torque_noise=0.3 * np.random.default_rng(1).standard_normal(6000))
    assert record.torque is not None
    larger = replace(record, torque=replace(record.torque, values=1.08 * record.torque.values))
    with pytest.raises(ji.MethodError, match=r"differs from the logged torque by -7.. % in size; expected one torque"):
        identify(larger, LAW, "torque", "motor_position")


def test_outputs_are_of_one_record() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)
    with pytest.raises(ji.MethodError, match="chosen for one record"):
        ji.identify([logged(), logged()], loop, ji.DIDIM(outputs=("motor_position",)))


def test_an_estimate_of_the_position_is_diagnosed_and_profiled() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)
    found = ji.identify(logged(), loop, ji.DIDIM(outputs=("motor_position",)), checks=False)
    assert ji.diagnose(found, logged()).axes[0].law is None
    (profile,) = ji.intervals(found, logged().without("torque")).profiles
    low, high = profile.interval
    assert low is not None and high is not None and low < 0.5 < high
    both = ji.identify(logged(), loop, ji.DIDIM(outputs=("torque", "motor_position")), checks=False)
    with pytest.raises(ji.MethodError, match="identify from one of them"):
        ji.diagnose(both, logged())


def test_a_wrong_ratio_of_gains_is_named() -> None:
    found = identify(logged().without("torque"), ji.controller.PD(position_gain=480.0, derivative_gain=30.0))
    assert not found.answer.reliable
    assert "the position gain is 17 % smaller than declared" in found.sentence
    assert "or the derivative gain is larger by the same factor" in found.sentence


def test_both_outputs_are_weighted_by_their_noise() -> None:
    noise = 0.5 * np.random.default_rng(1).standard_normal(6000)
    record = logged(torque_noise=noise, noise=5e-4)
    each = [identify(record, LAW, *outputs, checks=False) for outputs in (("torque",), ("motor_position",))]
    both = identify(record, LAW, "torque", "motor_position", checks=False)
    assert max(map(abs, deviations(both))) < 3.5
    assert both.data.channels == ("torque", "motor_position", "reference")
    for name in ("inertia", "viscous", "coulomb"):  # 0.5 to 0.55 of the smaller one
        assert both.params[name].stderr < 0.7 * min(one.params[name].stderr for one in each)
    assert scale_status(both) == []


@pytest.mark.parametrize("begin", [0.0, 0.6])
def test_an_integral_leaves_no_constant_torque(begin: float) -> None:
    law = ji.controller.Cascade(position_gain=15.0, velocity_gain=30.0, integral_gain=5.0)
    whole, first = logged(law).without("torque"), round(begin / SAMPLE_TIME)
    record = whole.with_channels(
        {name: replace(channel, values=channel.values[first:]) for name, channel in whole.items()}
    )
    found = identify(record, law, checks=False)
    assert found.params["offset"].value is None
    assert max(map(abs, deviations(found))) < 3.5
    assert any("offset includes what the integral held" in said for said in found.checks.warnings)


def test_a_drive_that_is_faster_than_its_log_biases_nothing() -> None:
    law = replace(LAW, period=1e-4)
    assert max(map(abs, deviations(identify(logged(law).without("torque"), law, checks=False)))) < 3.5


def test_the_derivatives_are_those_of_the_residual() -> None:
    law = replace(LAW, period=1e-3)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    record = ji.compute_controller_torque(logged(law).without("torque"), loop)
    problem = torque_problem(record, loop, ji.Filtering(), loop.joint.parameters)
    x = problem.vector(TRUTH | {"initial_position": 0.0, "initial_velocity": 0.0}) * 1.02
    slopes = problem.linearise(x)[1]
    for k, name in enumerate(p.name for p in problem.free[:3]):
        step = np.zeros_like(x)
        step[k] = 1e-5 * x[k]
        near = (problem.residual(x + step) - problem.residual(x - step)) / (2 * step[k])
        assert np.linalg.norm(slopes[:, k] - near) < 1e-3 * np.linalg.norm(near), name


def test_the_controller_is_not_compared_with_its_own_torque() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), LAW)
    assert compare_law(logged(), loop) is not None
    assert compare_law(ji.compute_controller_torque(logged(), loop), loop) is None


def test_outputs_that_no_record_has_are_refused() -> None:
    with pytest.raises(ji.MethodError, match="outputs of DIDIM are torque and motor_position"):
        ji.DIDIM(outputs=("load_position",))
    with pytest.raises(ji.RecordError, match="needs torque"):
        identify(logged().without("torque"), LAW, "torque", "motor_position")


FILE = """
[joint]
kind = "revolute"
[record]
file = "x.csv"
sample_time = 2e-3
{record}
[record.channels]
reference = {{ column = "ref" }}
motor_position = {{ column = "q" }}
{channels}
[controller]
law = "pd"
position_gain = 400.0
derivative_gain = 30.0
[method]
{method}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    record = logged()
    assert record.reference is not None and record.motor_position is not None and record.torque is not None
    columns = np.column_stack([record.reference.values, record.motor_position.values, record.torque.values])
    np.savetxt(tmp_path / "x.csv", columns, delimiter=",", header="ref,q,tau", comments="")
    return tmp_path


def test_a_joint_file_without_a_torque_channel_computes_it(folder: Path) -> None:
    (folder / "joint.toml").write_text(FILE.format(record="", channels="", method=""))
    file = ji.load(folder / "joint.toml")
    record = file.record()
    assert record.computed and record.torque is not None
    assert scale_status(file.identify(record, checks=False)) == ["unknown"]


def test_idim_takes_a_computed_torque_when_it_is_asked_for(folder: Path) -> None:
    (folder / "joint.toml").write_text(
        FILE.format(record='torque = "from_controller"', channels="", method='name = "idim"')
    )
    file = ji.load(folder / "joint.toml")
    found = file.identify(file.record())
    assert found.params["inertia"].value == pytest.approx(0.5, rel=0.01)
    assert scale_status(found) == ["unknown"]
    assert found.sentence.endswith("instrument.")


def test_a_computed_torque_beside_a_logged_one_is_refused() -> None:
    text = FILE.format(record='torque = "from_controller"', channels='torque = { column = "tau" }', method="").replace(
        'motor_position = { column = "q" }', ""
    )
    with pytest.raises(ji.JointFileError) as refused:
        loads(text)
    assert 'record.torque is "from_controller" beside a torque channel; keep one of them.' in str(refused.value)
    assert "record.channels.motor_position is missing" in str(refused.value)


def test_a_robot_without_torques_is_identified_from_its_positions() -> None:
    from tests.estimation.robots.twin import arm, motion

    robot = arm(2)
    laws = tuple(ji.controller.PD(position_gain=p, derivative_gain=d) for p, d in ((6000.0, 400.0), (5000.0, 350.0)))
    loop = ji.robots.RobotLoop(robot, laws)
    references = motion(3, 2, 6.0)[0]
    asked = [ji.Record(reference=ji.Channel(one, "rad", SAMPLE_TIME)) for one in (references - references[0]).T]
    random = np.random.default_rng(2)
    records = []
    for record in simulate(loop, asked).records(asked):
        assert record.motor_position is not None
        values = record.motor_position.values + 1e-5 * random.standard_normal(len(record.motor_position))
        records.append(replace(record, torque=None, motor_position=replace(record.motor_position, values=values)))
    found = ji.identify(records, loop, checks=False)
    assert scale_status(found) == ["unknown"]
    assert max(found.fit.axis_errors.values()) < 0.05
    assert found.params["joint1.viscous"].value == pytest.approx(robot.joints[0].viscous, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"])
def test_torque_and_position_of_the_real_axis_agree(name: str, data_dir: Path) -> None:
    file = ji.load(Path(__file__).parents[2] / "examples" / "emps" / "joint.toml")
    record = file.record(data_dir / "emps" / name)
    assert file.loop is not None
    torque, position = (
        ji.identify(record, file.loop, ji.DIDIM(outputs=(output,)), checks=False)
        for output in ("torque", "motor_position")
    )
    for row in torque.params.rows[:4]:
        assert abs((position.params[row.name].value or 0.0) - (row.value or 0.0)) < 0.2 * row.deviation
