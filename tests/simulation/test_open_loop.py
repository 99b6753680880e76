"""A joint under a prescribed torque: against the response of a linear system, and differences."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.paper.twin import TABLE_2
from jointid.records.record import Channel, Timing
from jointid.simulation.prescribed import simulate_open_loop

T = 1e-3
AROUND = {"initial_position": 0.1, "initial_velocity": 0.02, "log_delay": 3.3e-4}
RIGID = {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": 1.0}


def torque(samples: int = 4000) -> np.ndarray:
    t, rng = np.arange(samples) * T, np.random.default_rng(1)
    tones = (1, 2, 3, 5, 8, 13, 19, 24, 29, 37)
    return np.sum([40 * np.sin(2 * np.pi * f * t + rng.uniform(0, 6.3)) for f in tones], axis=0)


def channel(values: np.ndarray, timing: Timing = Timing.HELD) -> Channel:
    return Channel(values, "N", T, timing)


def test_a_frictionless_mass_is_the_double_integral_of_what_is_held() -> None:
    values = {"inertia": 50.0, "viscous": 0.0, "coulomb": 0.0, "offset": 0.0} | AROUND | {"log_delay": 0.0}
    u = torque(500)
    run = simulate_open_loop(RigidJoint("prismatic"), channel(u), values)
    speed = 0.02 + np.concatenate([[0.0], np.cumsum(u[:-1])]) * T / 50.0
    where = 0.1 + np.concatenate([[0.0], np.cumsum(speed[:-1] * T + 0.5 * u[:-1] * T**2 / 50.0)])
    assert np.allclose(run.position, where, rtol=0, atol=1e-12)


def test_a_log_that_is_a_sample_late_acts_a_sample_earlier() -> None:
    values, u = TABLE_2 | AROUND, torque()
    early = simulate_open_loop(FlexibleJoint("prismatic"), channel(u), values | {"log_delay": T}).position
    moved = simulate_open_loop(
        FlexibleJoint("prismatic"), channel(np.append(u[1:], u[-1])), values | {"log_delay": 0.0}
    ).position
    assert np.allclose(early, moved, rtol=0, atol=1e-12)


def test_timing_says_when_a_torque_acts() -> None:
    values, u = TABLE_2 | AROUND, torque()
    held = simulate_open_loop(FlexibleJoint("prismatic"), channel(u), values | {"log_delay": 0.5 * T}).position
    sampled = simulate_open_loop(
        FlexibleJoint("prismatic"), channel(u, Timing.SAMPLED), values | {"log_delay": 0.0}
    ).position
    assert np.allclose(held, sampled, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("joint", "truth"), [(FlexibleJoint("prismatic"), TABLE_2), (RigidJoint("prismatic"), RIGID)])
def test_derivatives_are_those_of_differences(joint: Joint, truth: dict[str, float]) -> None:
    values = dict(truth) | AROUND
    names = [p.name for p in joint.parameters] + list(AROUND)
    run = simulate_open_loop(joint, channel(torque()), values, names)
    for i, name in enumerate(names):
        step = 1e-5 * abs(values[name])
        above, below = (
            simulate_open_loop(joint, channel(torque()), {**values, name: values[name] + s}).position
            for s in (step, -step)
        )
        slope = (above - below) / (2 * step)
        assert np.linalg.norm(slope - run.derivatives[:, i]) < 5e-4 * np.linalg.norm(slope), name


def test_what_no_joint_has_is_not_simulated() -> None:
    run = simulate_open_loop(
        RigidJoint("prismatic"), channel(torque()), RIGID | AROUND | {"inertia": -1.0}, ["inertia"]
    )
    assert not run.finished
    assert not np.any(run.derivatives)
