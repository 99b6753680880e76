"""Mistakes of a robot's log or model: what the diagnosis of its estimate by IDIM names first.

Three robots of 4 to 6 joints move for six seconds. Their logs are computed from their equations of motion, with encoder
steps and a noise of one percent of each torque. A mistake is made in the log, in the declared robot, or in the truth.
What is named first is the first fault of the estimate's checks, or the sentence that refuses the log.

    python -m studies.robot_mistakes
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.estimation.parameters import mass_matrix_at
from jointid.models.controllers import PD
from jointid.models.robots.robot import JointSpring, Robot, RobotJoint, RobotLoop
from jointid.records.record import Channel, Record, Timing
from tests.estimation.robots.twin import arm
from tests.models.robots.trees import inverse_dynamics
from tests.robots_plants import seven, six

_STEP, _SECONDS, _NOISE, _COUNT = 2e-3, 6.0, 0.01, 2e-6  # s, s, of each torque, and rad of the encoders
_PUSH = 1.5 * np.sin(np.pi * np.clip(_STEP * np.arange(round(_SECONDS / _STEP)) - 2.0, 0.0, 1.0)) ** 2
_OFF = 0.1  # of each link's inertial parameters: the model's own masses are off by so much


@dataclass(frozen=True)
class Truth:
    """A robot as it is: with springs, other friction, and what its drives log of a motion.

    Attributes:
        robot: as it is. model: as it is declared.
        friction: returns the motors' friction beside lines, (samples, n), of positions, velocities and torques.
        log: changes positions and torques, (samples, n) each, as they are logged.
        limit: share of the last joint's torque at which its drive stops; the command beyond it is logged.
        reference: whether the motion that was asked for is logged as the position.
    """

    robot: Robot
    model: Robot
    friction: Callable[[FloatArray, FloatArray, FloatArray], FloatArray] = lambda q, v, torque: np.zeros_like(q)
    log: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]] = lambda q, torque: (q, torque)
    limit: float = 0.0
    reference: bool = False


def robots() -> tuple[Robot, ...]:
    """Return three robots, of 4, 5 and 6 joints, with limits of their positions."""
    panda, room = seven().robot, ji.AxisLimits(-3.1, 3.1)
    found = arm(4), replace(panda, links=panda.links[:5], joints=panda.joints[:5]), six().robot
    return tuple(replace(one, links=tuple(replace(link, limits=room) for link in one.links)) for one in found)


def declared(robot: Robot, seed: int) -> Robot:
    """Return the robot as its model has it: masses are off."""
    off = np.random.default_rng([seed, 3]).uniform(1.0 - _OFF, 1.0 + _OFF, (len(robot), 1))
    return replace(robot.with_inertials(robot.inertials * off), joints=tuple(map(RobotJoint, robot.names)))


def motion(seed: int, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return eight harmonics of 0.17 Hz, and a small multisine of 3 to 8 Hz: positions, velocities, accelerations."""
    random, t = np.random.default_rng(seed), np.arange(round(_SECONDS / _STEP))[:, np.newaxis] * _STEP
    slow, fast = (1.0 / _SECONDS) * np.arange(1, 9), np.arange(3.0, 8.0, 1.0) + 1 / 12
    q, v, a = np.zeros((3, t.size, n))
    for hertz, travel in [*((f, 0.25 / (6.0 * f)) for f in slow), *((f, 0.015 / f) for f in fast)]:
        w = 2 * np.pi * hertz
        size, phase = travel * random.uniform(0.4, 1.6, n) * 3.0, random.uniform(0, 2 * np.pi, n)
        q += size * np.sin(w * t + phase)
        v += w * size * np.cos(w * t + phase)
        a -= w * w * size * np.sin(w * t + phase)
    return q + random.uniform(-0.6, 0.6, n), v, a


def logs(truth: Truth, seed: int) -> tuple[Record, ...]:
    """Return what the drives of a robot log."""
    robot, (q, v, a) = truth.robot, motion(seed, len(truth.robot))
    random, coupling, asked = np.random.default_rng([seed, 1]), robot.coupling, q
    if truth.limit or truth.reference:
        q, torque, asked = follow(robot, q, truth.limit)
        q = asked if truth.reference else q
    else:
        through = inverse_dynamics(robot.tree, robot.inertials, q, v, a)
        bend = np.array([0.0 if one.spring is None else 1.0 / one.spring.stiffness for one in robot.joints])
        wound = [through * bend]
        for _ in range(2):
            wound.append(np.gradient(wound[-1], _STEP, axis=0))
        q, v, a = ((one + more) @ coupling.T for one, more in zip((q, v, a), wound, strict=True))
        torque = through @ np.linalg.inv(coupling)
        rotor, viscous, coulomb, offset = (
            robot.of_joints(name) for name in ("rotor_inertia", "viscous", "coulomb", "offset")
        )
        torque = torque + rotor * a + viscous * v + coulomb * np.sign(v) + offset + truth.friction(q, v, torque)
    torque = torque + _NOISE * np.std(torque, axis=0) * random.normal(size=torque.shape)
    if not truth.reference:
        q = _COUNT * np.round(q / _COUNT)
    q, torque = truth.log(q, torque)
    timing = Timing.HELD if truth.limit or truth.reference else Timing.SAMPLED
    logged = [
        Record(torque=Channel(torque[:, k], "N m", _STEP, timing), motor_position=Channel(q[:, k], "rad", _STEP))
        for k in range(len(robot))
    ]
    if truth.reference:
        logged = [replace(one, reference=Channel(asked[:, k], "rad", _STEP)) for k, one in enumerate(logged)]
    return tuple(logged)


def follow(robot: Robot, asked: FloatArray, limit: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions and commands of PD controllers that follow a motion from rest, and the motion."""
    t = np.arange(len(asked))[:, np.newaxis] * _STEP
    x = np.clip(t / 0.5, 0.0, 1.0)
    asked = asked[0] + (asked - asked[0]) * x**3 * (10 - 15 * x + 6 * x * x)
    felt = np.diag(mass_matrix_at(robot.tree, robot.inertials, np.zeros(len(robot)))) + robot.of_joints("rotor_inertia")
    w = 2 * np.pi * 8.0
    drives = tuple(Record(reference=Channel(one, "rad", _STEP)) for one in asked.T)

    def run(top: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        laws = [PD(position_gain=i * w * w, derivative_gain=1.8 * i * w, gain=1.0) for i in felt]
        if top:
            laws[-1] = replace(laws[-1], limit=top)
        made = ji.simulate(RobotLoop(robot, tuple(laws)), drives)
        q, torque = made.motor_position, made.torque
        error = asked - q
        rate = np.vstack([np.zeros(len(robot)), np.diff(error, axis=0)]) / _STEP
        return q, torque, felt * w * (w * error + 1.8 * rate)

    q, torque, command = run(0.0)
    if limit:
        q, torque, command = run(limit * float(np.max(np.abs(torque[:, -1]))))
        torque = np.column_stack([torque[:, :-1], command[:, -1]])
    return q, torque, asked


@dataclass(frozen=True)
class Mistake:
    """A mistake, and what may name it.

    Attributes:
        name: of it. right: names of faults, of which the first that is named must be one, each with its joint from
            1, 0 for any. make: returns the truth of a robot.
    """

    name: str
    right: Callable[[int], tuple[tuple[str, int], ...]]
    make: Callable[[Robot, int], Truth]


def _logged(change: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]) -> Callable[..., Truth]:
    return lambda robot, seed: Truth(robot, declared(robot, seed), log=change)


def _scaled(values: FloatArray, joint: int, by: float) -> FloatArray:
    factors = np.ones(values.shape[1])
    factors[joint] = by
    return values * factors


def _moved(values: FloatArray, joint: int, by: float | FloatArray) -> FloatArray:
    more = np.zeros_like(values)
    more[:, joint] = by
    return values + more


def _exchanged(values: FloatArray, first: int, second: int) -> FloatArray:
    order = np.arange(values.shape[1])
    order[[first, second]] = second, first
    return values[:, order]


def _late(values: FloatArray, samples: int) -> FloatArray:
    return np.vstack([np.repeat(values[:1], samples, axis=0), values[:-samples]])


def _held(values: FloatArray, joint: int, samples: int) -> FloatArray:
    values = values.copy()
    values[:, joint] = np.repeat(values[::samples, joint], samples)[: len(values)]
    return values


def _with_joint(robot: Robot, place: int, **more: object) -> Robot:
    joints = list(robot.joints)
    joints[place] = replace(joints[place], **more)  # type: ignore[arg-type]
    return replace(robot, joints=tuple(joints))


def _upside_down(robot: Robot, seed: int) -> Truth:
    return Truth(replace(robot, gravity=-robot.gravity), declared(robot, seed))


def _longer(robot: Robot, seed: int) -> Truth:
    links = list(robot.links)
    links[2] = replace(links[2], origin=1.4 * links[2].origin + np.array([0.0, 0.03, 0.0]))
    return Truth(replace(robot, links=tuple(links)), declared(robot, seed))


def _coupled(robot: Robot, seed: int) -> Truth:
    return Truth(_with_joint(robot, -1, coupling={robot.names[-2]: -1.0}), declared(robot, seed))


def _elastic(robot: Robot, seed: int) -> Truth:
    rotor = robot.joints[1].rotor_inertia
    inertia = mass_matrix_at(robot.tree, robot.inertials, np.zeros(len(robot)))[1, 1]
    held = inertia * rotor / (inertia + rotor)
    return Truth(_with_joint(robot, 1, spring=JointSpring(held * (2 * np.pi * 14.0) ** 2)), declared(robot, seed))


def _friction(of: Callable[[FloatArray, FloatArray, FloatArray, RobotJoint], FloatArray]) -> Callable[..., Truth]:
    """Return the truth with a friction of the second joint: of its position, velocity and torque, (samples,)."""

    def make(robot: Robot, seed: int) -> Truth:
        def more(q: FloatArray, v: FloatArray, torque: FloatArray) -> FloatArray:
            found = np.zeros_like(q)
            found[:, 1] = of(q[:, 1], v[:, 1], torque[:, 1], robot.joints[1])
            return found

        return Truth(robot, declared(robot, seed), friction=more)

    return make


def _any(*names: str) -> Callable[[int], tuple[tuple[str, int], ...]]:
    return lambda n: tuple((name, 0) for name in names)


def _at(joint: int, *names: str) -> Callable[[int], tuple[tuple[str, int], ...]]:
    return lambda n: tuple((name, joint % n + 1 if joint < 0 else joint + 1) for name in names)


MISTAKES = (
    Mistake("sign", _at(2, "torque_sign"), _logged(lambda q, u: (q, _scaled(u, 2, -1.0)))),
    Mistake("swap", _at(1, "swapped_channels"), _logged(lambda q, u: (q, _exchanged(u, 1, 2)))),
    Mistake("scale", _at(1, "log_gain"), _logged(lambda q, u: (q, _scaled(u, 1, 0.7)))),
    Mistake("unit", _any("unit"), _logged(lambda q, u: (np.degrees(q), u))),
    Mistake("zero", _at(2, "zero"), _logged(lambda q, u: (_moved(q, 2, 0.5), u))),
    Mistake("order of joints", _any("order"), _logged(lambda q, u: (q[:, ::-1], u[:, ::-1]))),
    Mistake("base", _any("base"), _upside_down),
    Mistake("wrong model", _any("geometry"), _longer),
    Mistake("delay", _any("log_delay"), _logged(lambda q, u: (q, _late(u, 4)))),
    Mistake("refresh", _at(1, "sample_time"), _logged(lambda q, u: (q, _held(u, 1, 10)))),
    Mistake("wrong gear", _at(1, "gear_ratio"), _logged(lambda q, u: (_scaled(q, 1, 1.25), _scaled(u, 1, 0.8)))),
    Mistake("coupled wrist", _at(-1, "coupled"), _coupled),
    Mistake("elastic joint", _at(1, "compliance"), _elastic),
    Mistake(
        "Stribeck", _at(1, "stribeck"), _friction(lambda q, v, u, j: j.coulomb * np.exp(-np.abs(v) / 0.1) * np.sign(v))
    ),
    Mistake(
        "load friction", _at(1, "load_dependent_friction"), _friction(lambda q, v, u, j: 0.12 * np.abs(u) * np.sign(v))
    ),
    Mistake(
        "temperature", _at(1, "changing_friction"),
        _friction(lambda q, v, u, j: -0.5 * j.viscous * v * (1.0 - np.exp(-3.0 * np.linspace(0.0, 1.0, v.size)))),
    ),
    Mistake("saturated drive", _at(-1, "limit"), lambda r, s: Truth(r, declared(r, s), limit=0.7)),
    Mistake(
        "reference for position", _any("reference_is_position"), lambda r, s: Truth(r, declared(r, s), reference=True)
    ),
    Mistake("contact", _at(1, "misfit_in_part"), _logged(lambda q, u: (q, _moved(u, 1, _PUSH * np.std(u[:, 1]))))),
    Mistake("logs exchanged", _any("order"), _logged(lambda q, u: (_exchanged(q, 1, 3), _exchanged(u, 1, 3)))),
)  # fmt: skip


def say(truth: Truth, seed: int) -> list[tuple[str, int]]:
    """Return the causes that are named of a robot's log, the first first, each with its joint from 1 or 0."""
    records, names = logs(truth, seed), truth.model.names
    try:
        found = ji.identify(records, truth.model, ji.IDIM())
    except JointidError as error:
        return [("unit" if "its unit" in str(error) else f"refused: {error}", 0)]
    said = [("sample_time", names.index(one.split(":")[0]) + 1) for one in found.warnings if "sample_time" in one]
    diagnosis = found.diagnosis
    assert isinstance(diagnosis, Diagnosis)
    if diagnosis.cause is not None:
        said.append((diagnosis.cause.name, names.index(diagnosis.cause.joints[0]) + 1 if diagnosis.cause.joints else 0))
    said += [("misfit_in_part", k + 1) for k, axis in enumerate(diagnosis.axes) if axis.faults.part is not None]
    said += [(one.test.name, k + 1) for k, axis in enumerate(diagnosis.axes) for one in axis.faults.findings]
    said += [("log_delay", 0) for one in found.warnings if "late" in one]
    said += [("?", k + 1) for k, axis in enumerate(diagnosis.axes) if not axis.explained]
    return said


def judge(seed: int, mistake: str) -> list[tuple[str, int]]:
    """Return what is named of a robot with a mistake, or without one where none is given."""
    robot = robots()[seed % 3]
    one = next((each for each in MISTAKES if each.name == mistake), None)
    return say(Truth(robot, declared(robot, seed)) if one is None else one.make(robot, seed), seed)


def is_right(seed: int, mistake: str, named: Sequence[tuple[str, int]]) -> bool:
    """Return whether a mistake is named first, or nothing where there is none."""
    one = next((each for each in MISTAKES if each.name == mistake), None)
    if one is None or not named:
        return one is None and not named
    right = one.right(len(robots()[seed % 3]))
    return tuple(named[0]) in right or (named[0][0], 0) in right


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each mistake."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[one.name for one in MISTAKES], help="names of mistakes")
    parser.add_argument("--named", action="store_true", help="print what is named of each")
    parser.add_argument("--clean", type=int, default=20, help="robots without a mistake")
    parser.add_argument("--first", type=int, default=0, help="seed")
    given = parser.parse_args(arguments)
    for mistake, count in [*((one, 3) for one in given.only), *([("", given.clean)] if given.clean else [])]:
        each = {seed: judge(seed, mistake) for seed in range(given.first, given.first + count)}
        right = sum(is_right(seed, mistake, named) for seed, named in each.items())
        sys.stdout.write(f"{mistake or 'none':24} {right} of {count}\n")
        if given.named:
            sys.stdout.writelines(f"  {seed}: {named[:5]}\n" for seed, named in each.items())
        sys.stdout.flush()


if __name__ == "__main__":
    main()
