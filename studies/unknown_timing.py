"""Intervals of rigid joints and robots where nobody stated whether the logged torque is held or sampled.

An arm of two joints under PD laws is simulated by small steps, apart from the package's simulation. A joint alone is
its first one, with nothing on it. The laws run at the log's rate, whose torque is held, or at each step, whose torque
is sampled. IDIM and the drive side are not told which.
"""

from __future__ import annotations

import numba
import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.drive_side import DriveSideFit
from jointid.estimation.methods.idim import IDIM
from jointid.models.joints import RigidJoint
from jointid.models.robots.inertial import MassProperties
from jointid.models.robots.robot import Link, Robot, RobotJoint
from jointid.records.record import Channel, Record, Timing

TRUE = {"inertia": 0.05, "viscous": 0.4, "coulomb": 0.5}
"""The joint: kg m2, N m s/rad and N m."""

_LENGTH, _MASS, _CENTRE, _ABOUT = 0.3, 0.5, 0.2, 0.02  # m, kg, m, kg m2: of the second link, behind the first
ARM = Robot(
    (
        Link("link1", -1, "revolute", inertial=MassProperties(1.0, np.zeros(3), np.diag([0.1, 0.1, 0.1])).inertial),
        Link(
            "link2", 0, "revolute", origin=np.array([_LENGTH, 0.0, 0.0]),
            inertial=MassProperties(_MASS, np.array([_CENTRE, 0.0, 0.0]), np.diag([0.01, 0.02, _ABOUT])).inertial,
        ),
    ),
    (RobotJoint("joint1", 0.05, 0.8, 1.0), RobotJoint("joint2", 0.02, 0.4, 0.5)),
    np.zeros(3),
)  # fmt: skip
"""Two links that turn about parallel axes."""

OTHERS = (
    *(f"drive side {name}" for name in TRUE), "arm Izz1", "arm Izz2", "arm mx2", "arm my2",
    "arm joint2.rotor_inertia", "arm joint1.viscous", "arm joint1.coulomb", "arm joint2.viscous", "arm joint2.coulomb",
)  # fmt: skip
"""The parameters whose intervals are counted, beside those of a joint by IDIM."""

_RATES = 30.0, 1000.0  # Hz
_DURATION = 12.0  # s
_STEP = 2e-4  # s, at most; and a tenth of a sample
_NOISE = 0.02  # of the torque
_SWEEPS = 4  # of the impulses of friction on both joints


def judge(seed: int, held: bool, way: str = "") -> dict[str, float]:
    """Return the error of each parameter in its deviations, at a rate that is drawn.

    Args:
        seed: of rate, motion and noise.
        held: whether the torque was.
        way: "" for a joint by IDIM, "arm" for an arm, "drive side" for a joint by that, whose delay is said to be 0.
    """
    low, high = np.log(_RATES)
    rate = float(np.exp(np.random.default_rng([seed, 1]).uniform(low, high)))
    records, joint, true = logged(rate, held, seed, arm=way == "arm"), RigidJoint("revolute"), TRUE
    if way == "drive side":
        found = identify(records[0], joint, DriveSideFit(log_delay=0.0), checks=False)
    elif not way:
        found = identify(records[0], joint, IDIM(), checks=False)
    else:
        found = identify(records, ARM, IDIM(), checks=False)
        part = found.require_robot()
        values = part.parameters_of(ARM)
        assert values is not None
        true = dict(zip(part.names, map(float, values), strict=True))
    rows = ((found[name], value) for name, value in true.items())
    return {
        f"{way} {row.name}".strip(): float(((row.value or 0.0) - value) / (row.stderr or 0.0)) for row, value in rows
    }


def logged(rate: float, held: bool, seed: int, noise: float = _NOISE, *, arm: bool = False) -> list[Record]:
    """Return the record of a joint that follows four sines, or those of the two joints of an arm.

    Args:
        rate: of the log, Hz.
        held: whether the law runs at that rate, else at each step.
        seed: of sines and noise.
        noise: on the log, of the torque.
        arm: whether it is an arm.
    """
    period = 1 / rate
    parts = max(round(period / _STEP), 10)
    step, size = period / parts, round(_DURATION * rate)
    axes = [np.random.default_rng([seed, axis] if axis else seed) for axis in range(2 if arm else 1)]
    time, references = step * np.arange(size * parts)[:, np.newaxis], np.zeros((size * parts, 2, 2))
    for axis, rng in enumerate(axes):
        w = 2 * np.pi * rng.uniform(0.15, 0.022 * min(rate, 60.0), 4)
        a = 0.8 / w * rng.uniform(0.5, 1.5, 4)
        phase = rng.uniform(0, 6, 4)
        references[:, 0, axis] = (a * np.sin(w * time + phase)).sum(1)
        references[:, 1, axis] = (a * w * np.cos(w * time + phase)).sum(1)
    stiff = min(2 * np.pi * rate / 25, 40.0)
    if arm:
        joints = [(joint.viscous, joint.coulomb) for joint in ARM.joints]
        second = _ABOUT + _MASS * _CENTRE**2
        first = ARM.links[0].inertial[-1] + ARM.joints[0].rotor_inertia + second + _MASS * _LENGTH**2
        mass = np.array([first, second, _MASS * _LENGTH * _CENTRE, ARM.joints[1].rotor_inertia])
    else:
        joints = [(TRUE["viscous"], TRUE["coulomb"]), (0.0, 0.0)]
        mass = np.array([TRUE["inertia"], 0.0, 0.0, 1.0])
    position, torque = _follow(references, mass, np.array(joints), stiff, parts if held else 1, parts, step)
    return [
        Record(
            torque=Channel(u + noise * u.std() * rng.standard_normal(size), "N m", period, Timing.HELD, stated=False),
            motor_position=Channel(q, "rad", period),
        )
        for q, u, rng in zip(position.T, torque.T, axes, strict=False)
    ]


@numba.njit(cache=False)
def _follow(
    references: FloatArray, mass: FloatArray, friction: FloatArray, stiff: float, every: int, parts: int, step: float
) -> tuple[FloatArray, FloatArray]:
    """Return the positions and torques of both joints, (samples, 2) each.

    Args:
        references: (steps, 2, 2) positions and velocities.
        mass: inertia about the first joint with a straight arm less twice its coupling, about the second one, coupling,
            second rotor.
        friction: (2, 2) viscous and Coulomb friction of each joint.
        stiff: bandwidth of the laws, rad/s.
        every: steps of the laws.
        parts: steps of a sample.
        step: s.
    """
    first, second, coupling, rotor = mass
    q, v, u, impulse = references[0, 0].copy(), references[0, 1].copy(), np.zeros(2), np.zeros(2)
    positions, torques = np.zeros((len(references) // parts, 2)), np.zeros((len(references) // parts, 2))
    for k in range(len(references)):
        for i in range(2):
            if k % every == 0:
                asked = stiff**2 * (references[k, 0, i] - q[i]) + 1.4 * stiff * (references[k, 1, i] - v[i])
                u[i] = (second + rotor if i else first) * asked + friction[i, 0] * references[k, 1, i]
            if k % parts == 0:
                positions[k // parts, i], torques[k // parts, i] = q[i], u[i]
        bent, turn = coupling * np.cos(q[1]), coupling * np.sin(q[1])
        m11, m12, m22 = first + 2 * bent, second + bent, second + rotor
        size = m11 * m22 - m12 * m12
        push = u[0] - friction[0, 0] * v[0] + turn * v[1] * (2 * v[0] + v[1])
        pull = u[1] - friction[1, 0] * v[1] - turn * v[0] * v[0]
        v[0] += step * (m22 * push - m12 * pull) / size
        v[1] += step * (m11 * pull - m12 * push) / size
        impulse[:] = 0.0
        for _ in range(_SWEEPS):
            for i in range(2):
                own, most = (m11 if i else m22) / size, step * friction[i, 1]
                change = min(max(impulse[i] + v[i] / own, -most), most) - impulse[i]
                impulse[i] += change
                v[i] -= own * change
                v[1 - i] += m12 / size * change
        for i in range(2):
            q[i] += step * v[i]
    return positions, torques
