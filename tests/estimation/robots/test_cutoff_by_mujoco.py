"""The default cut-off on robots that MuJoCo moved, with the steps, rates and noise of a TX40's and a Panda's logs."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo, of the extra robots, makes the independent data")

import mujoco

from jointid.common.arrays import FloatArray
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.problems.inverse_model import inverse_of_robot
from jointid.estimation.robots.idim import identify_robot
from jointid.records.record import Channel, Record, Tap
from jointid.records.signals.filtering import Filtering
from tests.robots_mujoco import model_of
from tests.robots_plants import Twin, motion, seven, six

RATE, DURATION = 1000.0, 10.0  # Hz, s
BY_HAND = (6.0, 15.0, 40.0)  # Hz


def moved(twin: Twin, seed: int, faster: float, digit: float, noise: float, torque_noise: float) -> list[Record]:
    """Return records of a motion whose torques are MuJoCo's inverse dynamics, with friction of each joint added.

    Args:
        twin: of revolute joints without springs.
        seed: of the motion and the noise.
        faster: than harmonics of 0.1 Hz.
        digit: rad, of the positions. noise: rad, of them.
        torque_noise: of each torque's deviation.
    """
    bare = replace(twin.robot, joints=tuple(replace(joint, viscous=0.0, coulomb=0.0) for joint in twin.robot.joints))
    model, rng, step = model_of(bare, 1e-3), np.random.default_rng([seed, 5]), 1e-3
    data = mujoco.MjData(model)
    t = np.arange(round(DURATION * RATE)) / RATE
    around = [twin.home + motion(faster * (t + k * step), seed, twin.travel) for k in (-2, -1, 0, 1, 2)]
    q = around[2]
    v = (around[0] - 8 * around[1] + 8 * around[3] - around[4]) / (12 * step)
    a = (-around[0] + 16 * around[1] - 30 * q + 16 * around[3] - around[4]) / (12 * step**2)
    torques = np.empty_like(q)
    for k in range(t.size):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        mujoco.mj_inverse(model, data)
        torques[k] = data.qfrc_inverse
    viscous, coulomb = (
        np.array([getattr(joint, name) for joint in twin.robot.joints]) for name in ("viscous", "coulomb")
    )
    torques += viscous * v + coulomb * np.sign(v)
    torques += torque_noise * torques.std(axis=0) * rng.standard_normal(q.shape)
    seen = q + noise * rng.standard_normal(q.shape)
    seen = np.round(seen / digit) * digit if digit else seen
    return [
        Record(
            torque=Channel(u, "N m", 1 / RATE, "sampled"), motor_position=Channel(p, "rad", 1 / RATE), tap=Tap.MEASURED
        )
        for u, p in zip(torques.T, seen.T, strict=True)
    ]


def errors(twin: Twin, records: list[Record], fresh: list[Record], cutoff: float | None) -> tuple[float, float, float]:
    """Return the largest error of a joint's fresh torque, of a friction or rotor, as shares; and the cut-off, Hz."""
    found = identify_robot(twin.robot, records, IDIM(), filtering=Filtering(cutoff=cutoff))
    part = found.require_robot()
    inverse = inverse_of_robot(twin.robot, part.parameters)
    rows = inverse.rows([inverse.measure(fresh, Filtering(cutoff=10.0))])
    true = part.parameters_of(twin.robot)
    own = np.array([name.endswith(("viscous", "coulomb", "rotor_inertia")) for name in part.names])
    used = found.settings.filtering.cutoff
    off: FloatArray = np.abs(part.values - true)[own] / true[own]
    return float(np.max(rows.relative_errors(part.values))), float(np.max(off)), used


@pytest.mark.slow
@pytest.mark.parametrize(
    ("twin", "digit", "noise", "torque_noise"),
    [(six(), 1e-5, 0.0, 0.02), (seven(), 0.0, 1e-4, 0.05)],
    ids=["TX40", "Panda"],
)
def test_default_cutoff_is_as_good_as_the_best_by_hand(
    twin: Twin, digit: float, noise: float, torque_noise: float
) -> None:
    records = moved(twin, 1, 2.0, digit, noise, torque_noise)
    fresh = moved(twin, 2, 2.0, 0.0, 0.0, 0.0)
    torque, parameters, cutoff = errors(twin, records, fresh, None)
    by_hand = [errors(twin, records, fresh, hertz) for hertz in BY_HAND]
    assert torque < min(one[0] for one in by_hand) + 0.02
    assert parameters < min(one[1] for one in by_hand) + 0.02
    assert parameters < 0.02
    if noise:  # at 4 % of the rate it pulls 11 % of a rotor
        assert cutoff < 25.0
        assert by_hand[-1][1] > 3 * parameters
