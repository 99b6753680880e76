"""Records of two seconds and loops of a third of a hertz: little to begin a search with, enough to end one."""

import math
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.paper.twin import TABLE_2, twin
from jointid.records.chunks import cut
from studies.healthy import drive


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2)), 3])
def test_two_seconds_of_an_axis_that_moves_are_enough(seed: int) -> None:
    axis = twin("L19", noise="white", seed=seed)
    record = cut(axis.record.without("motor_position", "load_position"), 3000, 5000)
    line = ji.identify(record, axis.loop, checks=False)["stiffness"]
    assert line.value == pytest.approx(TABLE_2["stiffness"], abs=3 * line.stderr)
    assert line.stderr < 0.03 * line.value


@pytest.mark.slow
def test_a_loop_of_a_third_of_a_hertz_is_identified() -> None:
    pace = 2 * math.pi * 0.3
    law = ji.controller.Cascade(position_gain=0.25 * pace, velocity_gain=0.5 * pace, period=1e-3)
    truth = {
        "motor_inertia": 0.25, "motor_viscous": 0.03, "motor_coulomb": 0.05, "stiffness": 0.125 * (3 * pace) ** 2,
        "damping": 0.04 * 0.125 * 3 * pace, "load_inertia": 0.25, "load_viscous": 0.02, "load_coulomb": 0.05,
        "offset": 0.02,
    }  # fmt: skip
    loop = ji.ClosedLoop(ji.FlexibleJoint("revolute"), law)
    reference = ji.excitation.trapezoids((1.0, 2.0), 2.0, 2.0, 1e-3, duration=40.0)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    found = ji.identify(record.without("motor_position", "load_position"), loop, checks=False)
    assert found["stiffness"].value == pytest.approx(truth["stiffness"], rel=1e-6)


MODES = [(9247, 12.0, "", "stiffness"), (70083, 8.0, "log", "stiffness"), (70011, 8.0, "white force", "stiffness")]
MODES += [(90155, 8.0, "coloured force", "offset"), (90168, 8.0, "coloured force", "stiffness")]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "longest", "noise", "name"), MODES)
def test_no_false_minimum(seed: int, longest: float, noise: str, name: str) -> None:
    """Of a mode inside the bandwidth, which hides friction, too, or of a constant force in place of held friction."""
    axis = drive(seed, longest, noise)
    low, high = ji.identify(axis.record, axis.loop, checks=False)[name].interval
    assert low < axis.truth[name] < high


@pytest.mark.parametrize(
    ("gains", "seed", "first"),
    [
        ((60.0, 9000.0, 0.0), 12, 11_687),  # in motion
        ((60.0, 9000.0, 0.0), 10, 17_225),  # at rest; the Coulomb friction holds the motor
        ((20.0, 1000.0, 0.0), 9, 7_537),  # the reference rests, and the motor follows it still
        ((10.0, 1000.0, 5.0), 4, 18_540),  # in motion under an integral
    ],
)
def test_six_seconds_begun_anywhere_have_one_answer(gains: tuple[float, float, float], seed: int, first: int) -> None:
    """A few reversals tell the Coulomb friction: what sticks, and how the motor begins, must not hide it."""
    law = ji.controller.Cascade(**dict(zip(("position_gain", "velocity_gain", "integral_gain"), gains, strict=True)))
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
    truth = {"inertia": 95.0, "viscous": 205.0, "coulomb": 20.0, "offset": -3.0}
    rng = np.random.default_rng([seed, 77])
    speeds = tuple(rng.permutation([0.05, 0.1, 0.2]) * rng.uniform(0.7, 1.3))
    reference = ji.excitation.trapezoids(speeds, rng.uniform(0.8, 2.0), 0.2, 1e-3, duration=30.0, rest=0.3)
    whole = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    noise = 0.01 * np.std(whole.torque.values)
    noisy = replace(whole.torque, values=whole.torque.values + noise * rng.standard_normal(reference.size))
    part = cut(ji.Record(torque=noisy, reference=whole.reference), first, first + 6000)
    estimate = ji.identify(part, loop, checks=False)
    assert estimate.fit.filtered_error < 5e-3  # the noise leaves 0.4 %, another friction 0.4 to 7 %
    for name, value in truth.items():
        line = estimate[name]
        assert line.value is not None and line.stderr is not None
        assert line.value == pytest.approx(value, abs=3.5 * line.stderr)


@pytest.mark.parametrize("seed", [3, 5])
def test_steps_on_scaled_gains_that_lead_to_no_joint_leave_the_start(seed: int) -> None:
    """At 100 Hz Coulomb friction hides the inertia of a joint that an injected torque moves 4 ms late."""
    rng, time = np.random.default_rng(seed), 1e-2 * np.arange(400)

    def waves(lowest: float, highest: float, size: float) -> FloatArray:
        frequencies = np.geomspace(lowest, highest, 24)
        wave = np.sin(2 * np.pi * frequencies * time[:, None] + rng.uniform(0, 6.28, 24)).sum(axis=1)
        return np.asarray(size * wave / np.abs(wave).max())

    law = ji.controller.PD(position_gain=8.3, derivative_gain=0.38, period=1e-3)
    loop = ji.ClosedLoop(ji.RigidJoint("revolute"), law)
    late = replace(loop, controller=replace(law, delay=4e-3))
    reference, injected = waves(0.2, 2.0, 0.4), waves(1.0, 40.0, 2.0)

    def record(noise: FloatArray) -> ji.Record:
        return ji.simulated_record(
            late, reference, {"inertia": 0.012, "viscous": 0.1, "coulomb": 0.53, "offset": 0.0}, sample_time=1e-2,
            injected=injected, at="before_limit", tap="measured", torque_noise=noise,
        )  # fmt: skip

    torque = record(np.zeros(400)).torque
    found = ji.identify(record(0.04 * np.std(torque.values) * rng.standard_normal(400)), loop, checks=False)
    assert found["inertia"].value == pytest.approx(0.012, abs=3 * found["inertia"].deviation)
