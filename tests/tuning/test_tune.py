"""What is stated and proposed: the worst of an interval is its worst, and what is proposed does what it should."""

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.config import loads
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import Check, Reason, Subject
from jointid.models.controllers import PD, PID, Cascade
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity
from jointid.output.json import dumps, to_dict
from jointid.paper.twin import twin
from jointid.records.chunks import cut
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from jointid.tuning.margins import NAMES, joint_set, possible_joints
from jointid.tuning.proposals import with_gains
from jointid.tuning.tune import Tuned, tune
from studies.margins import random_drive, true_margins
from tests.estimates import amended, identify
from tests.joint_files import CHANNELS, JOINT

PERIOD = 1e-3
REFERENCE = trapezoids((0.05, 0.12), 0.8, 0.2, PERIOD, duration=6.0)
RIGID = {"inertia": 100.0, "viscous": 150.0, "coulomb": 20.0, "offset": 3.0}
RIGID |= {"gravity_constant": 3.0, "counterbalance_rate": 500.0}  # where a joint has one


@pytest.fixture(scope="module")
def estimate() -> Estimate:
    axis = twin(seed=4)
    record = cut(axis.record.without("motor_position", "load_position"), 0, 8000)
    return identify(record, axis.loop, DIDIM(frequency=30.0))


@pytest.fixture(scope="module")
def tuned(estimate: Estimate) -> Tuned:
    return tune(estimate)


def rigid(controller: Cascade | PD | StateSpaceController, joint: RigidJoint | None = None) -> Estimate:
    """A rigid joint identified under a controller, with a little noise."""
    loop = ClosedLoop(joint or RigidJoint("prismatic"), controller)
    force = 2.0 * np.random.default_rng(1).standard_normal(REFERENCE.size)
    record = simulated_record(loop, REFERENCE, RIGID, sample_time=PERIOD, disturbance=force)
    return identify(record.without("motor_position", "load_position"), loop)


def test_what_is_proposed_keeps_the_margins_and_could_not_be_much_stiffer(estimate: Estimate, tuned: Tuned) -> None:
    worst, asked = tuned.proposed.worst, tuned.settings
    assert worst.gain >= 0.995 * asked.gain_margin
    assert math.degrees(worst.phase) >= 0.995 * asked.phase_margin
    assert worst.modulus >= 0.995 * asked.modulus
    controller = tuned.proposed.controller
    faster = replace(
        controller, position_gain=1.1 * controller.position_gain, velocity_gain=1.1 * controller.velocity_gain
    ).law(PERIOD)
    nominal = joint_set(estimate.settings.joint, [estimate.values], faster).margins(faster)[0]
    assert np.any(nominal < asked.asked)
    assert controller.position_gain * controller.velocity_gain > 1.2 * 160.18 * 243.45  # stiffer, and with more phase


def test_a_controller_in_ampere_is_told_in_ampere() -> None:
    text = JOINT + 'torque_constant = "5 N/A"\n' + CHANNELS.replace('"i"', '"i", unit = "A"')
    gains = 'position_gain = "8000 A/m"\nderivative_gain = "400 A s/m"\nintegral_gain = "20000 A/(m s)"\n'
    estimate = rigid(loads(f'{text}[controller]\nlaw = "pid"\n{gains}').controller)
    tuned = tune(estimate, notch=False)
    assert [gain.key for gain in tuned.gains] == ["position_gain", "derivative_gain", "integral_gain"]
    assert [gain.unit for gain in tuned.gains] == ["A per m", "A per m/s", "A per m s"]
    [_, derivative, integral] = [(gain.before, gain.after) for gain in tuned.gains]
    law = tuned.proposed.controller
    assert derivative == (pytest.approx(400.0), pytest.approx(law.derivative_gain))
    assert integral == (pytest.approx(20000.0), pytest.approx(law.integral_gain))
    assert tuned.feedforward[0].after == pytest.approx(estimate.values["inertia"] / 5.0)


@pytest.mark.slow
def test_a_notch_is_proposed_where_the_mode_limits_the_loop() -> None:
    drive = random_drive(0)
    truth = dict(drive.truth) | {"damping": 0.1 * drive.truth["damping"]}
    slow = Cascade(
        position_gain=0.05 * 6.28 * drive.mode,
        velocity_gain=0.1 * 6.28 * drive.mode * (truth["motor_inertia"] + truth["load_inertia"]),
    )
    late = replace(slow, delay=2 * drive.period)
    drive = replace(drive, loop=ClosedLoop(drive.loop.joint, late), truth=truth, noise=0.1 * drive.noise)
    estimate = drive.identified(drive.record(1))
    with_it, without = tune(estimate), tune(estimate, notch=False)
    assert without.notch is None and with_it.notch is not None
    assert with_it.notch.frequency == pytest.approx(drive.mode, rel=0.02)
    assert with_it.proposed is not None and without.proposed is not None
    stiffness = [math.prod(gain.after for gain in one.gains) for one in (with_it, without)]
    assert stiffness[0] > 1.2 * stiffness[1]
    true = true_margins(drive, with_it.proposed.controller)
    assert all(value >= getattr(with_it.proposed.worst, name) for value, name in zip(true, NAMES, strict=True))


@pytest.mark.parametrize("damping", [0.5, 1.0])
@pytest.mark.parametrize(
    "controller",
    [
        Cascade(position_gain=20.0, velocity_gain=100.0, integral_gain=3.0, gain=30.0, ratio=-4.0),
        PD(position_gain=2e3, derivative_gain=100.0, gain=30.0),
        PID(position_gain=2e3, derivative_gain=100.0, integral_gain=5e3, gain=30.0),
    ],
)
def test_a_layout_has_the_poles_that_its_formula_says(controller: Cascade | PD, damping: float) -> None:
    inertia, rate, slow = 100.0, 10.0, 1e-5
    made = with_gains(
        replace(controller, integral_gain=0.0) if type(controller) is not PD else controller, inertia, rate, damping
    )
    # Slow against its period the law is -(proportional + derivative s).
    response = made.law(slow).feedback(np.array([1e-3, 1.0]))
    proportional, derivative = -response[0].real, -response[1].imag / (2 * math.pi)
    assert derivative / inertia == pytest.approx(rate, rel=1e-3)
    assert proportional / inertia == pytest.approx(rate**2 / (4 * damping**2), rel=1e-3)
    again = with_gains(with_gains(controller, inertia, rate, damping), inertia, 2 * rate, damping)
    if isinstance(again, PID | Cascade):
        first = with_gains(controller, inertia, rate, damping)
        assert again.integral_gain == pytest.approx(first.integral_gain * (8 if isinstance(again, PID) else 2))


@pytest.mark.parametrize("ratio", [1.0, -5.0])
def test_feed_forward_leaves_nothing_to_the_feedback(ratio: float) -> None:
    controller = Cascade(
        position_gain=20.0, velocity_gain=2000.0 / ratio**2 / 3.0, gain=3.0, ratio=ratio, velocity_feedforward=1.0
    )
    found = tune(rigid(controller))
    proposed = {f.key: f.after for f in found.feedforward}
    errors = []
    for one in (controller, replace(controller, **proposed)):
        run = simulated_record(ClosedLoop(RigidJoint("prismatic"), one), REFERENCE, RIGID, sample_time=PERIOD)
        errors.append(float(np.std(run.motor_position.values - REFERENCE)))
    assert errors[1] < 0.1 * errors[0]


def test_of_friction_that_differs_the_mean_is_fed_forward() -> None:
    joint = RigidJoint("prismatic", friction=Friction("asymmetric"))
    values = {"inertia": 100.0, "viscous_forwards": 100.0, "viscous_backwards": 200.0, "offset": 0.0}
    values |= {"coulomb_forwards": 30.0, "coulomb_backwards": 20.0}
    loop = ClosedLoop(joint, Cascade(position_gain=20.0, velocity_gain=2000.0))
    force = np.random.default_rng(1).standard_normal(REFERENCE.size)
    record = simulated_record(loop, REFERENCE, values, sample_time=PERIOD, disturbance=force)
    found = {f.key: f for f in tune(identify(record.without("motor_position", "load_position"), loop)).feedforward}
    assert found["viscous_feedforward"].after == pytest.approx(150.0, rel=0.1)
    assert found["coulomb_feedforward"].after == pytest.approx(25.0, rel=0.1)
    assert found["constant_feedforward"].after == pytest.approx(5.0, rel=0.2)


def test_a_spring_that_carries_the_load_is_in_the_margins_and_not_in_the_feed_forward() -> None:
    law, balanced = Cascade(position_gain=20.0, velocity_gain=2000.0), Gravity("constant", Counterbalance(rate=500.0))
    found = tune(rigid(law, RigidJoint("prismatic", gravity=balanced)))
    assert [note.partition(" leave")[0] for note in found.notes] == ["margins and feed-forward", "feed-forward"]
    assert not any("turns" in note for note in found.notes)


@pytest.mark.slow
def test_an_interval_that_holds_unstable_joints_states_no_margin(estimate: Estimate) -> None:
    wide = tuple(replace(p, stderr=6 * p.stderr) if p.stderr else p for p in estimate.rows)
    controller = estimate.settings.loop.controller
    # 8.5 times as fast it would not be stable.
    fast = ClosedLoop(estimate.settings.joint, replace(controller, velocity_gain=8.2 * controller.velocity_gain))
    found = tune(replace(amended(estimate, settings={"loop": fast}), rows=wide), gain_margin=1e6, notch=False)
    assert found.present.estimate.stable and not found.present.worst.stable and found.proposed is None
    assert json.loads(dumps(to_dict(found)))["present"]["worst"]["modulus"] == 0.0


def test_the_interval_is_the_one_that_is_printed_with_its_lack_of_fit(estimate: Estimate) -> None:
    each = [tuple(replace(p, lack_of_fit=by * (p.stderr or 0.0)) for p in estimate.rows) for by in (0.0, 3.0)]
    alone, whole = (possible_joints(replace(estimate, rows=rows), 0.95).factor for rows in each)
    np.testing.assert_allclose(whole, 10**0.5 * alone, rtol=1e-12)


def test_an_interval_stops_short_of_a_joint_without_a_spring(estimate: Estimate) -> None:
    wide = tuple(replace(p, stderr=p.value) if p.name == "stiffness" else p for p in estimate.rows)
    interval = possible_joints(replace(estimate, rows=wide), 0.95)
    joints = interval.at(np.concatenate([np.eye(len(interval.names)), -np.eye(len(interval.names))]))
    assert min(one["stiffness"] for one in joints) == pytest.approx(1e-3 * estimate.values["stiffness"])
    law = Cascade(position_gain=10.0, velocity_gain=10.0, gain=35.0).law(PERIOD)
    assert np.all(np.isfinite(joint_set(interval.joint, joints, law).margins(law)[:, -1]))


def test_of_a_state_space_law_only_margins_are_told() -> None:
    law = StateSpaceController(
        A=[[0.0]], B={"position": [1.0]}, C=[8e6], D={"reference": 4e5, "position": -8.4e6}, gain=1.0
    )
    found = tune(rigid(law))
    assert found.present.worst.stable and found.proposed is None and not found.gains


def test_a_loop_in_doubt_is_doubted_in_the_first_sentence() -> None:
    words = "velocity_gain is larger than declared"
    failed = Check(Reason.LOOP_NOT_AS_DECLARED, words, name=Subject.LOOP, passed=False)
    tuned = tune(replace(rigid(Cascade(position_gain=20.0, velocity_gain=2000.0)), checks=(failed,)))
    assert tuned.sentence.startswith("Beware: ") and len(tuned.doubts) == 1
    assert words in tuned.doubts[0]


@pytest.mark.parametrize(
    "asked",
    [
        lambda found: tune(identify(twin().record, twin().loop.joint.rigid, IDIM())),
        lambda found: tune(replace(found, correlation=np.zeros((0, 0)))),
        lambda found: tune(replace(found, rows=tuple(replace(one, value=None) for one in found.rows))),
        lambda found: tune(found, gain_margin=0.5),
        lambda found: tune(found, confidence=1.0),
        lambda found: tune(found, foo=1.0),
    ],
)
def test_what_cannot_be_tuned_is_refused(estimate: Estimate, asked: Callable[[Estimate], object]) -> None:
    with pytest.raises(MethodError):
        asked(estimate)
