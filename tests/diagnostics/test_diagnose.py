"""A record is looked over: seven spoiled ones, each named for what it is; clean ones, of which nothing is said."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.config import load
from jointid.diagnostics.diagnose import diagnose
from jointid.diagnostics.explain import explain_failure
from jointid.diagnostics.model_free import Agreement, compare_law
from jointid.estimation.methods.idim import IDIM
from jointid.models.controllers import PD, Cascade
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.output.json import to_dict
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimation.robots.twin import arm, records_of
from tests.mistakes import MISTAKES, Told, axis, run, varied, without_mistake


def _mistake(name: str) -> Callable[[str], Told]:
    (one,) = [mistake for mistake in MISTAKES if mistake.name == name]
    return lambda on: one.make(axis(on), 1)  # type: ignore[arg-type]


def _saturated(on: str) -> Told:
    """The drive's limit is at 0.7 of the torque it would take, and the log shows that."""
    made = axis(on)  # type: ignore[arg-type]
    free, _ = without_mistake(made)
    size = float(np.quantile(np.abs(free.torque.values), 0.9))
    law = replace(made.controller, limit=0.8 * size * made.controller.limit / made.controller.law(made.rate).limit)
    return run(made, law), ClosedLoop(made.joint, law)


def _motionless(on: str) -> Told:
    made = axis(on)  # type: ignore[arg-type]
    still = replace(made, reference=1e-7 * made.reference)
    return without_mistake(still)


def _noise(on: str) -> Told:
    record, loop = without_mistake(axis(on))  # type: ignore[arg-type]
    noise = np.random.default_rng(1).standard_normal(record.torque.values.size)
    return record.with_channels({"torque": replace(record.torque, values=float(noise.std()) * 30 * noise)}), loop


# What makes each, and the codes that name it: with the motor's position first, then without.
SPOILED: dict[str, tuple[Callable[[str], Told], set[str], set[str]]] = {
    "saturation": (_saturated, {"at_limit", "unreadable"}, {"at_limit", "unreadable"}),
    "wrong sign": (_mistake("torque turned round"), {"law_scaled"}, {"torque_sign", "reference_sign"}),
    "wrong unit": (
        _mistake("reference in mm"),
        {"law_differs", "reference_scale", "torque_scale", "law_gain", "unreadable"},
        {"reference_scale", "torque_scale", "law_gain", "unreadable"},
    ),
    "wrong gain": (_mistake("torque twice as large"), {"law_scaled"}, {"torque_scale", "law_gain", "torque_constant"}),
    "half the rate": (_mistake("sample time twice as long"), {"sample_time"}, {"sample_time"}),
    "no motion": (_motionless, {"motion_poor", "hardly_moves"}, {"motion_poor", "hardly_moves", "no_cause_found"}),
    "pure noise": (_noise, {"torque_column", "law_differs"}, {"torque_column", "cause_found"}),
}


@pytest.mark.slow
@pytest.mark.parametrize(("spoiled", "on"), [*((one, "rigid") for one in SPOILED), ("wrong gain", "flexible")])
def test_a_spoiled_record_is_named_for_what_it_is(spoiled: str, on: str) -> None:
    make, with_position, without = SPOILED[spoiled]
    record, loop = make(on)
    for one, codes in ((record, with_position), (record.without("motor_position", "load_position"), without)):
        found = diagnose(one, loop)
        assert {symptom.code for symptom in found.symptoms if symptom.spoils} & codes, str(found)


@pytest.mark.slow
def test_nothing_is_wrong_with_a_record_at_its_declared_limit() -> None:
    law = Cascade(position_gain=20.0, velocity_gain=1.0, limit=1.1)
    loop = ClosedLoop(RigidJoint("revolute"), law)
    truth = {"inertia": 0.03, "viscous": 0.05, "coulomb": 0.1, "offset": 0.02}
    reference = trapezoids((4.0, 8.0), 30.0, 3.0, 1e-3, rest=0.1, duration=8.0)
    noise = 5e-3 * np.random.default_rng(1).standard_normal(reference.size)
    record = simulated_record(loop, reference, truth, sample_time=1e-3, torque_noise=noise, tap="measured")
    assert 0.1 < np.mean(np.abs(record.torque.values) > 0.99 * 1.1) < 0.4
    assert diagnose(record, loop).healthy


def test_a_law_holds_that_is_fifty_times_faster_than_the_log_of_a_motion_up_to_a_fifth_of_its_rate() -> None:
    law = PD(position_gain=40.0, derivative_gain=2.0, reference_velocity="channel", period=1e-4, interpolation="hold")
    time, period = 5e-3 * np.arange(800), 1e-4
    frequencies, phases = np.geomspace(0.3, 40.0, 24), np.random.default_rng(4).uniform(0, 2 * np.pi, 24)

    def position(at: FloatArray) -> FloatArray:
        return 0.02 * np.sin(2 * np.pi * frequencies * at[:, None] + phases).sum(axis=1)

    torque = -40.0 * position(time) - 2.0 * (position(time) - position(time - period)) / period
    still = np.zeros(time.size)
    record = Record(
        torque=Channel(torque, "N m", 5e-3, Timing.HELD),
        reference=Channel(still, "rad", 5e-3),
        reference_velocity=Channel(still, "rad/s", 5e-3),
        motor_position=Channel(position(time), "rad", 5e-3, Timing.SAMPLED),
    )
    found = compare_law(record, ClosedLoop(RigidJoint("revolute"), law))
    assert found.left < 0.01  # lines between the positions leave 44 %, and show a delay of half a sample
    assert found.late == 0.0 and found.holds


def test_the_law_is_seen_in_the_motor_s_position_alone() -> None:
    made = axis("rigid")
    record, loop = without_mistake(varied(made, 3))
    found = compare_law(record, loop)
    assert found.left < 0.05 and (found.late, found.gain) == (0.0, pytest.approx(1.0, abs=0.01))
    assert compare_law(record.without("motor_position"), loop) is None
    late = replace(record.torque, values=np.roll(record.torque.values, 3))
    T = record.torque.sample_time
    assert compare_law(record.with_channels({"torque": late}), loop).late == pytest.approx(3 * T, abs=0.05 * T)
    half = replace(record.torque, values=0.5 * record.torque.values)
    scaled = compare_law(record.with_channels({"torque": half}), loop)
    assert scaled.gain == pytest.approx(0.5 * found.gain, rel=1e-6)
    for left, code in ((0.0103, Agreement.SCALED), (0.0127, Agreement.DIFFERS)):  # by a loop on the load's encoder
        assert replace(scaled, left=left, gain=1.067, noise=0.0103).agreement.code is code


@pytest.mark.slow
@pytest.mark.parametrize("name", ["DATA_EMPS", "DATA_EMPS_PULSES"])
def test_a_real_axis_is_looked_over(name: str, data_dir: Path) -> None:
    file = load(Path(__file__).parents[2] / "examples" / "emps" / "joint.toml")
    record = file.record(data_dir / "emps" / f"{name}.mat")
    assert file.loop is not None
    assert diagnose(record, file.loop, file.method, filtering=file.filtering).healthy
    compared = compare_law(record, file.loop)
    assert compared.left < min(0.003, 1.05 * compared.noise)  # nothing but rounding


def test_what_is_missing_or_never_changes_is_said_at_once() -> None:
    record, loop = without_mistake(axis("rigid"))
    assert diagnose(record.without("reference"), loop).symptoms[0].code == "unreadable"
    dead = replace(record.torque, values=0.0 * record.torque.values)
    assert diagnose(record.with_channels({"torque": dead}), loop).symptoms[0].code == "motion_poor"
    still = record.with_channels({"reference": replace(record.reference, values=0.0 * record.reference.values)})
    assert explain_failure(RecordError("still"), still, loop, print).code == "unreadable"
    assert [one.code for one in diagnose(still, loop).symptoms] == ["motion_poor"]
    short = {name: replace(one, values=one.values[:12]) for name, one in record.items()}
    assert not diagnose(Record(**short, name="short"), loop).healthy  # type: ignore[arg-type]


@pytest.mark.slow
def test_each_joint_of_a_robot_is_looked_over_under_its_name_and_the_clock_once() -> None:
    records = list(records_of(arm(), 2, noise=0.05))
    found = diagnose(records, arm(), IDIM())
    assert found.healthy and found.axes
    torque = records[2].torque
    coarse = replace(torque, values=np.repeat(torque.values[::10], 10)[: torque.values.size])
    records[2] = replace(records[2], torque=coarse)
    spoiled = diagnose(records, arm(), IDIM())
    assert spoiled.symptoms[0].code == "torque_coarse"
    assert to_dict(spoiled)["symptoms"][0]["axis"] == "joint3"
    with pytest.raises(MethodError):
        diagnose(records[:2], arm())
