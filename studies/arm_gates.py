"""A seven-joint arm that MuJoCo moves in steps of 0.1 ms, identified from its noisy log, beside gates on the errors.

`python -m studies.arm_gates` prints the table of `docs/how-well-it-works.md`; two numbers are other seeds: the first,
and the one after the last.

Each seed draws an arm and a motion of 20 s: places of a usual arm of seven joints, and masses, armatures, damping and
friction within 30 % of usual ones. A PD law runs at 1 kHz with a delay of 0.5 ms and, as a feed-forward, the weight by
a wrong model. It logs reference, feed-forward, position and torque at 1 kHz, with white noise of 2e-4 rad and 0.3 N m.
The identification is given geometry, law and feed-forward, and no inertial number of the arm. It reads no velocity.

Friction and damping are those of all joints. The armature of the first two joints is identifiable as a sum with links;
its error is that of the sum. An arm's own links are identifiable in sums alone: mass and centre are those of a payload
of 2 kg in a second log. The parameters within 2 sigma are the 69 of the first log and the ten of the payload.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.estimation.result.answer import Trust
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Timing
from jointid.simulation.robot_numbers import RobotNumbers
from studies.seeds import judge_seeds, parse_seeds

STEP, PERIOD, DELAY, LENGTH = 1e-4, 1e-3, 5e-4, 20.0  # s: of MuJoCo, of law and log, of the law, of a log
NOISE = {"position": 2e-4, "torque": 0.3}  # rad, N m
COLUMNS = {"both": ("torque", "motor_position"), "torque": ("torque",), "position": ("motor_position",)}
"""Columns of the table, and the outputs that are identified from."""

ROWS = ("friction, %", "damping, %", "armature, %", "payload's mass, %", "payload's centre, mm")
GATES, EXPECTED = (15.0, 30.0, math.nan, 3.0, 5.0), (3.0, 5.0, 3.0, 1.0, 2.0)  # of the same rows
_GAINS = ((800.0, 60.0), (800.0, 60.0), (600.0, 45.0), (600.0, 40.0), (250.0, 16.0), (220.0, 14.0), (120.0, 8.0))
_PLACES = (0.16, 0.2, 0.2, 0.22, 0.18, 0.2, 0.09)  # m along the axis before
_AXES = ("0 0 1", "0 1 0", "0 0 1", "0 -1 0", "0 0 1", "0 1 0", "0 0 1")
_MASSES, _RADII = (4.1, 3.8, 3.1, 2.8, 1.8, 1.7, 0.5), (0.12, 0.10, 0.11, 0.10, 0.09, 0.06, 0.035)  # kg, m of gyration
_CENTRES = (
    (0.0, -0.03, 0.12), (0.0, 0.06, 0.05), (0.0, 0.03, 0.13), (0.0, 0.06, 0.04), (0.0, 0.02, 0.08), (0.0, 0.0, 0.01),
    (0.0, 0.0, 0.02),
)  # fmt: skip
_ARMATURE, _DAMPING = (0.6, 0.6, 0.45, 0.45, 0.2, 0.15, 0.12), (8.0, 8.0, 5.0, 5.0, 2.0, 1.5, 1.0)
_FRICTION = (6.0, 6.5, 4.0, 4.0, 2.0, 1.8, 1.2)
_HOME, _TRAVEL = (0.0, 0.5, 0.0, -1.4, 0.0, 1.1, 0.0), (1.3, 0.8, 1.3, 0.8, 1.3, 0.9, 1.5)  # rad
_PAYLOAD = 2.0, np.array([0.02, -0.03, 0.12]), np.array([0.006, 0.005, 0.004, 5e-4, -4e-4, 3e-4])
"""Mass, kg, centre in the last link's frame, m, and inertia about it, kg m2 (xx, yy, zz, xy, xz, yz)."""


def arm(random: np.random.Generator, *, loaded: bool = False) -> tuple[str, str]:
    """Return an arm as MJCF, without and with the payload.

    Coulomb friction is as hard as MuJoCo's step allows: its default lets a tenth of the force slip.
    """

    def about(values: Sequence[float], share: float) -> FloatArray:
        return np.array(values) * random.uniform(1 - share, 1 + share, len(values))

    opened = ""
    masses, armature, damping, friction = (about(values, 0.3) for values in (_MASSES, _ARMATURE, _DAMPING, _FRICTION))
    for k, mass in enumerate(masses):
        centre = np.array(_CENTRES[k]) + random.normal(0.0, 0.01, 3)
        moments = 0.5 * mass * _RADII[k] ** 2 * random.uniform(0.7, 1.3, 3)
        turn = Rotation.random(random_state=random).as_matrix()
        second = turn @ np.diag(moments) @ turn.T
        opened += f'<body name="link{k + 1}" pos="0 0 {_PLACES[k]}">'
        opened += _body(mass, centre, (np.trace(second) * np.eye(3) - second)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        opened += f'<joint name="joint{k + 1}" axis="{_AXES[k]}" armature="{armature[k]:.15g}" '
        opened += f'damping="{damping[k]:.15g}" frictionloss="{friction[k]:.15g}" '
        opened += 'solreffriction="2e-4 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"/>'
    ends = "</body>" * len(masses)
    return tuple(  # type: ignore[return-value]
        f'<mujoco model="arm"><compiler angle="radian"/><option timestep="{STEP}" integrator="implicitfast">'
        f'<flag contact="disable" limit="disable"/></option><worldbody>{opened}{carried}{ends}</worldbody><actuator>'
        + "".join(f'<motor joint="joint{k + 1}"/>' for k in range(len(masses)))
        + "</actuator></mujoco>"
        for carried in ("", f'<body name="payload">{_body(*_PAYLOAD)}</body>')
    )


def _body(mass: float, centre: FloatArray, inertia: FloatArray) -> str:
    at, about = (" ".join(f"{value:.15g}" for value in one) for one in (centre, inertia))
    return f'<inertial pos="{at}" mass="{mass:.15g}" fullinertia="{about}"/>'


def load(model: str) -> ji.Robot:
    """Return the robot of an MJCF text."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(model)
        return ji.robots.load_robot(path)


def motion(random: np.random.Generator, length: float = LENGTH) -> FloatArray:
    """Return references, (samples, 7): eight harmonics of 0.1 Hz, begun at rest."""
    t, w = np.arange(round(length / PERIOD)) * PERIOD, 0.2 * math.pi * np.arange(1, 9)
    a, b = random.uniform(-1.0, 1.0, (2, w.size, len(_TRAVEL)))
    q = np.sin(np.outer(t, w)) @ (a / w[:, np.newaxis]) - (np.cos(np.outer(t, w)) - 1.0) @ (b / w[:, np.newaxis])
    x = np.clip(t / 0.6, 0.0, 1.0)
    shown = np.array(_TRAVEL) * q / np.max(np.abs(q), axis=0)
    return np.asarray(np.array(_HOME) + shown * (x**3 * (10 - 15 * x + 6 * x * x))[:, np.newaxis])


def move(model: str, reference: FloatArray, given: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the positions and torques, (samples, 7) each, of an arm that MuJoCo moves under its law from rest.

    Args:
        model: MJCF.
        reference: (samples, 7).
        given: (samples, 7) the feed-forward.
    """
    import mujoco  # type: ignore[import-untyped]

    made = mujoco.MjModel.from_xml_string(model)
    data = mujoco.MjData(made)
    kp, kd = np.array(_GAINS).T
    data.qpos[:] = reference[0]
    mujoco.mj_forward(made, data)
    data.qpos[:] = reference[0] - (data.qfrc_bias - given[0]) / kp
    before = reference[0] - data.qpos
    data.ctrl[:] = kp * before + given[0]
    positions, torques, early = np.empty_like(reference), np.empty_like(reference), round(DELAY / STEP)
    for k, asked in enumerate(reference):
        error = asked - data.qpos
        torques[k] = kp * error + kd * (error - before) / PERIOD + given[k]
        positions[k], before = data.qpos, error
        mujoco.mj_step(made, data, early)
        data.ctrl[:] = torques[k]
        mujoco.mj_step(made, data, round(PERIOD / STEP) - early)
    return positions, torques


def log(loop: ji.robots.RobotLoop, model: str, random: np.random.Generator, length: float) -> tuple[Record, ...]:
    """Return the log of an arm: references, feed-forward, positions and torques with noise."""
    reference = motion(random, length)
    asked = [Record(reference=Channel(one, "rad", PERIOD)) for one in reference.T]
    fed = [one.injected for one in ji.robots.add_feed_forward(loop, asked, "gravity")]
    given = np.column_stack([one.channel.values for one in fed if one is not None])
    moved = move(model, reference, given)
    shown = (one + size * random.standard_normal(one.shape) for one, size in zip(moved, NOISE.values(), strict=True))
    return tuple(
        Record(
            reference=Channel(r, "rad", PERIOD), motor_position=Channel(q, "rad", PERIOD),
            torque=Channel(torque, "N m", PERIOD, Timing.HELD),
            injected=Injection(Channel(weight, "N m", PERIOD, Timing.HELD), InjectionPoint.BEFORE_LIMIT),
        )
        for r, q, torque, weight in zip(reference.T, *(one.T for one in shown), given.T, strict=True)
    )  # fmt: skip


@dataclass(frozen=True)
class Column:
    """What one choice of outputs gives of an arm.

    Attributes:
        errors: (rows,) the largest of a joint, by the rows of the table.
        z: errors of all parameters and of the payload's, in standard deviations, the reported ones.
        seconds: of the processor, of the identification of the first log with its checks.
        relied: whether the answer does not say that it may not be relied on.
    """

    errors: tuple[float, ...]
    z: tuple[float, ...]
    seconds: float
    relied: bool


def judge(seed: int, columns: Sequence[str] = tuple(COLUMNS), length: float = LENGTH) -> dict[str, Any]:
    """Identify the arm of a seed, and its payload, from each choice of outputs: columns as JSON has them."""
    random = np.random.default_rng([seed, 42])
    model, loaded = arm(random)
    laws = [_law(*gains) for gains in _GAINS]
    loop = ji.robots.RobotLoop(load(arm(np.random.default_rng(0))[0]), tuple(laws))  # another arm: the nominal one
    empty, carrying = (log(loop, one, random, length) for one in (model, loaded))
    return {name: asdict(_identify(loop, load(model), empty, carrying, COLUMNS[name])) for name in columns}


def _law(position_gain: float, derivative_gain: float) -> ji.controller.PD:
    return ji.controller.PD(
        position_gain=position_gain, derivative_gain=derivative_gain, delay=DELAY, undeclared="none"
    )


def _identify(
    loop: ji.robots.RobotLoop,
    truth: ji.Robot,
    empty: tuple[Record, ...],
    carrying: tuple[Record, ...],
    outputs: tuple[str, ...],
) -> Column:
    method, began = ji.DIDIM(outputs=outputs), time.process_time()
    estimate = ji.identify(empty, loop, method)
    spent = time.process_time() - began
    part = estimate.require_robot()
    assert isinstance(part, SimulatedRobot)
    names, values, std = part.names, part.values, np.array([row.stderr for row in estimate.params.rows])
    true = part.parameters.group_all(RobotNumbers.of(truth))
    off = values - true
    rotors = truth.of_joints("rotor_inertia")
    share = [
        [100 * abs(off[k]) / true[k] for k, name in enumerate(names) if name.endswith(kind)]
        for kind in (".coulomb", ".viscous")
    ]
    armature = [
        100 * abs(error) / rotor
        for error, formula in zip(off, part.formulas, strict=True)
        for j, rotor in enumerate(rotors)
        if f"Ia{j + 1}" in formula
    ]
    payload = ji.identify_payload(loop, estimate, carrying, method).payload
    found, spread = payload.properties
    mass, centre, inertia = _PAYLOAD
    apart = found - np.array([mass, *centre, *inertia])
    errors = (*map(max, (*share, armature)), 100 * abs(apart[0]) / mass, 1e3 * float(np.max(np.abs(apart[1:4]))))
    return Column(
        tuple(map(float, errors)), tuple(map(float, (*(off / std), *(apart / spread)))), spent,
        estimate.answer.trust.code is not Trust.NOT_YET,
    )  # fmt: skip


def summarise(runs: Sequence[dict[str, Any]]) -> str:
    """Return the table: the largest error of all arms and joints, what 2 sigma hold, and the processor's time."""
    columns = {name: [run[name] for run in runs] for name in COLUMNS if name in runs[0]}
    lines = [f"| {len(runs)} arms | gate | expected | {' | '.join(columns)} |", "|---" * (3 + len(columns)) + "|"]
    for k, row in enumerate(ROWS):
        worst = (f"{max(one['errors'][k] for one in column):.2g}" for column in columns.values())
        gate = "" if math.isnan(GATES[k]) else f"{GATES[k]:g}"
        lines.append(f"| {row} | {gate} | {EXPECTED[k]:g} | {' | '.join(worst)} |")
    held = (np.abs(np.concatenate([one["z"] for one in column])) <= 2.0 for column in columns.values())
    lines.append(f"| within 2 sigma, % | | 91 to 98.5 | {' | '.join(f'{100 * np.mean(one):.1f}' for one in held)} |")
    relied = (f"{sum(one['relied'] for one in column)}" for column in columns.values())
    lines.append(f"| to be relied on | | | {' | '.join(relied)} |")
    spent = (f"{np.median([one['seconds'] for one in column]):.0f}" for column in columns.values())
    lines.append(f"| s of the processor, median | 600 | 30 | {' | '.join(spent)} |")
    return "\n".join(lines)


def main() -> None:
    """Print the table."""
    given = parse_seeds(__doc__, 8)
    sys.stdout.write(summarise(list(judge_seeds("studies.arm_gates:judge", given.seeds, {}, out=given.out))) + "\n")


if __name__ == "__main__":
    main()
