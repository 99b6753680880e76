"""What a robot's record tells of each joint, and whether its controllers are as declared."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics import suspects
from jointid.diagnostics.analysis import intervals
from jointid.diagnostics.axis_torques import torques_of_robot
from jointid.diagnostics.diagnosis import Diagnosis, diagnose_robot
from jointid.diagnostics.identify import identify
from jointid.diagnostics.search import search_axes
from jointid.diagnostics.suspects import FAULTS, Fault
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.verdict import Subject
from jointid.models.controllers import Controller
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record
from jointid.simulation.synthesis import simulate, simulated_record
from tests.estimates import beside_tables
from tests.estimation.robots.twin import SAMPLE_TIME, arm, axis_errors, identified, motion, records_of
from tests.rigid_axis import LOOP, REFERENCE, TRUTH
from tests.robots_plants import two


def logged_by(loop: RobotLoop, drives: Sequence[Record] | None = None) -> tuple[Record, ...]:
    """Return what the drives of two joints log, with a thousandth of noise."""
    driven = two().records(6.0) if drives is None else drives
    made, rng = simulate(loop, driven).records(driven), np.random.default_rng(3)
    noisy = []
    for one in made:
        values = one.torque.values + 1e-3 * np.std(one.torque.values) * rng.normal(size=one.torque.values.size)
        noisy.append(replace(one, torque=replace(one.torque, values=values)))
    return tuple(noisy)


def asked(loop: RobotLoop, records: Sequence[Record], laws: Sequence[Controller]) -> Diagnosis:
    return diagnose_robot(identified(loop.robot, records), records, laws)


def named(found: Diagnosis) -> list[tuple[str, str]]:
    """Return the faults found, each with its axis."""
    return [(axis.name, one.test.name) for axis in found.axes for one in axis.faults.findings]


def logged_torque(records: Sequence[Record], joint: int, of: Callable[[FloatArray], FloatArray]) -> tuple[Record, ...]:
    """Return records with the torque of one joint logged otherwise."""
    torque = records[joint].torque
    other = replace(records[joint], torque=replace(torque, values=of(torque.values)))
    return (*records[:joint], other, *records[joint + 1 :])


def with_noise(records: Sequence[Record], seed: int, size: float) -> tuple[Record, ...]:
    """Return records with white noise on the positions, of a deviation in rad."""
    rng, found = np.random.default_rng([seed, 7]), []
    for one in records:
        q = one.motor_position
        found.append(replace(one, motor_position=replace(q, values=q.values + size * rng.normal(size=len(q)))))
    return tuple(found)


LOGS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "log_gain": lambda torque: 0.8 * torque,
    "torque_sign": lambda torque: -torque,
    "log_delay": lambda torque: np.concatenate([np.full(5, torque[0]), torque[:-5]]),
}
WRONG = ("log_gain", "torque_sign")
SLOWER = [*((6, joint, fault) for fault in WRONG for joint in range(6)), (6, 1, "log_delay"), (3, 1, "log_gain")]


@pytest.mark.parametrize(
    ("count", "joint", "fault"),
    [(3, 1, "torque_sign"), *(pytest.param(*one, marks=pytest.mark.slow) for one in SLOWER)],
)
def test_a_log_that_is_wrong_is_named_at_its_joint_by_the_coupling_with_the_others(
    count: int, joint: int, fault: str
) -> None:
    records = logged_torque(records_of(arm(count), 2, noise=0.05), joint, LOGS[fault])
    found = identify(records, arm(count), IDIM())
    diagnosis = found.diagnosis
    cause = diagnosis.cause
    said = [*named(diagnosis), *([] if cause is None else [(*cause.joints, cause.name)])]
    assert said == [(f"joint{joint + 1}", fault)] and any(one.passed is False for one in found.checks)
    assert found.answer.reliable or "next" in beside_tables(found)
    if fault == "log_gain":
        gain = 1.0 + diagnosis.axes[joint].faults.findings[0].test.size if cause is None else cause.value
        assert gain == pytest.approx(0.8, rel=0.1)  # by one step, beside the parameters of all joints


def test_a_scale_that_takes_the_torque_away_explains_nothing() -> None:
    records = logged_torque(records_of(arm(3), 2, noise=0.05), 1, lambda torque: 0.03 * torque)
    torques = torques_of_robot(identified(arm(3), records), records)
    assert not any(one.findings for one in search_axes(torques, [("rad", "N m")] * 3))


@pytest.mark.slow
def test_torques_that_are_exchanged_are_named_at_both_joints() -> None:
    records = list(records_of(arm(3), 2, noise=0.05))
    second, third = records[1], records[2]
    records[1], records[2] = replace(second, torque=third.torque), replace(third, torque=second.torque)
    estimate = identify(records, arm(3), IDIM())
    found = estimate.diagnosis
    assert found.cause is not None and named(found) == []
    assert (found.cause.name, found.cause.joints) == ("swapped_channels", ("joint2", "joint3"))


def test_gravity_that_the_model_lacks_is_named() -> None:
    records = records_of(arm(2), 2, noise=0.05)
    found = diagnose_robot(identified(replace(arm(2), gravity=np.zeros(3)), records), records)
    assert found.cause is not None and found.cause.name == "gravity" and named(found) == []
    assert diagnose_robot(identified(arm(2), records), records).cause is None


def drag(speed: FloatArray) -> FloatArray:
    """Return a force that no row of the table has, of size 1 at the largest speed."""
    return np.asarray((speed / np.max(np.abs(speed))) ** 3)


NEW = Fault(
    "drag", "drag of a fan", lambda seen: [(None, seen.force(-drag(seen.velocity)))], "take it off", measure="torque"
)
ADDED: dict[str, tuple[Callable[[FloatArray, FloatArray, FloatArray], FloatArray], float, float]] = {
    "load_dependent_friction": (lambda u, q, v: 0.1 * np.abs(u) * np.sign(v), 0.09, 0.02),
    "torque_saturation": (lambda u, q, v: 0.1 * u * (u / np.max(np.abs(u))) ** 2, 0.09, 0.03),
    "uneven_friction": (lambda u, q, v: 2.0 * np.sign(v) * (2.0 * (q - q.min()) / np.ptp(q) - 1.0), 2.0, 0.2),
    "drag": (lambda u, q, v: 3.0 * drag(v), 3.0, 0.3),
}
"""What adds to a torque along the motion, by the fault that it is, with its size and the tolerance of that."""


@pytest.fixture
def with_a_new_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add a fault to the table: one row."""
    monkeypatch.setattr(suspects, "_ROWS", (*suspects._ROWS, NEW))


@pytest.mark.slow
@pytest.mark.usefixtures("with_a_new_row")
@pytest.mark.parametrize("fault", ADDED)
def test_what_adds_to_the_torque_of_one_joint_is_named_with_its_size(fault: str) -> None:
    (added, size, within), (q, v, _) = ADDED[fault], motion(2, 3)
    records = records_of(arm(3), 2, noise=0.02)
    records = logged_torque(records, 1, lambda torque: torque + added(torque, q[:, 1], v[:, 1]))
    found = diagnose_robot(identified(arm(3), records), records)
    assert named(found) == [("joint2", fault)]
    assert found.axes[1].faults.findings[0].test.size == pytest.approx(size, abs=within)


@pytest.mark.usefixtures("with_a_new_row")
def test_a_new_fault_of_a_joint_is_that_row_too() -> None:
    noise = 0.3 * np.random.default_rng(0).standard_normal(REFERENCE.size)
    force = -10.0 * drag(np.gradient(REFERENCE))
    made = simulated_record(LOOP, REFERENCE, TRUTH, sample_time=1e-3, disturbance=force, torque_noise=noise)
    joint = identify(made.without("motor_position"), LOOP)
    assert named(joint.diagnosis) == [("", "drag")]
    assert joint.diagnosis.axes[0].faults.findings[0].test.size == pytest.approx(10.0, rel=0.15)
    assert beside_tables(joint)["next"].startswith("take it off")


@pytest.mark.slow
def test_samples_that_are_missing_are_named_with_their_place() -> None:
    records = records_of(arm(3), 2, noise=0.02)
    step = round(1.7 / SAMPLE_TIME)
    less = [
        one.with_channels(
            {name: replace(c, values=np.delete(c.values, np.s_[step : step + 4])) for name, c in one.items()}
        )
        for one in records
    ]
    found = identify(less, arm(3), IDIM())
    loop = found.about(Subject.LOOP)[0]
    assert loop.passed is False
    assert loop.words.startswith("samples are missing in the record: about 4 at 1.698 s")
    assert not any(one.name is Subject.LOOP and one.passed is False for one in identify(records, arm(3), IDIM()).checks)


@pytest.mark.slow
def test_a_model_that_holds_leaves_noise() -> None:
    records = records_of(arm(), 2, noise=0.2)
    found = diagnose_robot(identified(arm(), records), records)
    assert found.explained and named(found) == []
    assert found.as_declared is None
    assert all(one.whiteness is not None and one.whiteness.white for one in found.axes)


@pytest.mark.slow
def test_friction_that_rises_towards_standstill_is_named_at_its_joint() -> None:
    records = records_of(arm(4), 2, noise=0.02)
    v = motion(2, 4)[1][:, 3]
    more = logged_torque(records, 3, lambda torque: torque + 1.5 * np.sign(v) * np.exp(-np.abs(v) / 0.15))
    found = diagnose_robot(identified(arm(4), more), more)
    assert [one.name for one in found.axes if not one.explained] == ["joint4"]
    assert named(found) == [("joint4", "stribeck")]


def test_a_friction_that_differs_by_direction_is_named_until_it_is_declared() -> None:
    loop = two().loop()
    first, second = loop.robot.joints
    other = replace(loop.robot, joints=(replace(first, viscous_backwards=12.0), second))
    records = logged_by(RobotLoop(other, loop.controllers))
    found = diagnose_robot(identified(loop.robot, records), records).axes[0]
    assert not found.explained
    assert FAULTS["asymmetric_friction"] in [one.test.fault for one in found.faults.findings]
    assert diagnose_robot(identified(other, records), records).axes[0].left < 0.2 * found.left


@pytest.mark.slow
def test_the_motion_of_another_joint_is_named() -> None:
    records = records_of(arm(), 2, noise=0.02)
    more = logged_torque(records, 4, lambda torque: torque + 0.3 * motion(2)[2][:, 5])
    assert named(diagnose_robot(identified(arm(), more), more)) == [("joint5", "coupled_joint6")]


def test_controllers_that_make_the_torque_hold_and_others_do_not() -> None:
    loop = two().loop()
    records = logged_by(loop)
    found = asked(loop, records, loop.controllers)
    assert found.as_declared and found.explained
    first, second = loop.controllers
    stiffer = asked(loop, records, (first, replace(second, position_gain=1.3 * second.position_gain)))  # type: ignore[type-var, attr-defined]
    assert [one.law_holds for one in stiffer.axes] == [True, False]
    assert not stiffer.as_declared and any("joint2" in one for one in stiffer.sentences)


@pytest.mark.parametrize("seed", [0, 1, 2, *(pytest.param(one, marks=pytest.mark.slow) for one in range(3, 6))])
def test_noise_of_the_positions_is_neither_a_bent_gear_nor_another_law(seed: int) -> None:
    loop = two().loop()
    records = with_noise(logged_by(loop, two().records(6.0, seed + 1)), seed, (1e-5, 3e-6, 5e-5)[seed % 3])
    found = asked(loop, records, loop.controllers)
    assert named(found) == [] and found.as_declared


@pytest.mark.slow
def test_from_torques_alone_the_loop_is_not_seen_apart_from_the_model() -> None:
    loop = two().loop()
    records = [Record(torque=one.torque, reference=one.reference) for one in logged_by(loop)]
    estimate = identified(loop, records)
    found = diagnose_robot(estimate, records)
    assert found.as_declared is None and found.explained and beside_tables(estimate)
    with pytest.raises(MethodError, match="received that of a robot"):  # not one by DIDIM, which it is
        intervals(estimate, records[0])
    copied = [replace(one, motor_position=one.reference) for one in records]
    assert diagnose_robot(estimate, copied).cause.name == "reference_is_position"
    np.testing.assert_allclose([one.left for one in found.axes], axis_errors(estimate), rtol=1e-9)
    axes = tuple(replace(one, faults=replace(one.faults, explained=0.5)) for one in found.axes)
    assert [one[:19] for one in replace(found, axes=axes).sentences] == ["joint1 and joint2: "]
