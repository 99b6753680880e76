"""Causes of a misfit that concern more than the torque of one joint: a base, a gear, an order, a coupling, a length.

Each is a change of the log or of the model, with which the inverse model is solved again on some hundred instants. Its
numbers are searched on a grid, then by descent (variable projection). The rows of each joint are divided by the size of
its error as declared, so the sum of squares is the number of joints before a cause is corrected. The cause that lowers
it most is named.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import join, number
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.regression import motion_of_robot
from jointid.models.robots.base_parameters import inverse_columns
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, lowpass

_INSTANTS = 200
_RANK = 1e-12  # of the normal matrix, whose columns have length 1
_LEAST = 0.5  # of the squares of one joint's residual: what a cause explains at least
_SIMPLER = 1.25  # times: so much more may be left by a cause with one free number less
_BEST = 4  # causes whose numbers are searched, beside those that begin at what is declared:
_FROM_DECLARED = ("base", "geometry")
_STEPS = 8  # of a descent
_TWO = 2  # joints: one alone has none of these causes
_SAME = 1e-9  # of the travel
_REST = 0.02  # of the largest speed: below, Coulomb friction is left out
_ZEROS = tuple(np.pi / 6 * k for k in range(-5, 7) if k)  # rad
_GEARS = tuple(math.log(one) for one in (0.1, 0.3, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0, 10.0))
_UNITS = (math.log(180 / math.pi), -math.log(180 / math.pi), math.log(1e3), -math.log(1e3))
_COUPLED = (-1.0, -0.5, 0.5, 1.0)
_GRAVITY = 9.81  # m/s2
_OPPOSITE = 0.999  # of the cosine: of gravity that is said to be upside down
_LONGEST = 1.0  # m: a longer correction of a length is none
_SIGN = "the torque of {joint} has the wrong sign: set torque.sign = -1 in joints.channels, or in record.channels"

_OF_PAIRS = (
    ("swapped_channels", False, True, "the torques of {} and {} are exchanged: exchange the columns"),
    ("order", True, True, "the logs of {} and {} are exchanged: give each joint the columns of the other"),
    ("swapped_positions", True, False, "the positions of {} and {} are exchanged: exchange the columns"),
)
"""Of two joints: the code, whether positions and torques are exchanged, and the words."""

_OF_JOINTS: tuple[tuple[str, int, int, tuple[float, ...], str], ...] = (
    ("torque_sign", 0, 1, (), _SIGN),
    ("log_gain", 0, 1, _GEARS, "the logged torque of {joint} is {value} times what moves it: check its unit"),
    (
        "position_sign", 1, 0, (),
        "the position of {joint} has the wrong sign: set motor_position.sign = -1 in its joints.channels",
    ),
    (
        "joint_sign", 1, 1, (),
        "position and torque of {joint} count the other way than the model's axis: set motor_position.sign and "
        "torque.sign = -1 in its joints.channels",
    ),
    (
        "gear_ratio", 1, -1, _GEARS,
        "the gear of {joint} has {value} times the declared ratio: position and torque are off by it",
    ),
    (
        "position_scale", 1, 0, (*_GEARS, *_UNITS),
        "the position of {joint} is {value} times what moves the links: check its unit and its ratio",
    ),
)  # fmt: skip
"""Of one joint: the code, powers of a factor on position and torque, its starts (-1 alone if none), and the words."""


@dataclass(frozen=True, slots=True)
class RobotCause:
    """Cause of a misfit of a whole robot.

    Attributes:
        name: its code. joints: that it concerns; none of a base.
        words: clause that states it, with its remedy.
        value: its number; None without one.
        explained: squares of the residual that it explains, as a sum of the shares of all joints.
    """

    name: str
    joints: tuple[str, ...]
    words: str
    value: float | None = None
    explained: float = math.inf

    def __str__(self) -> str:
        return self.words


class _Case(NamedTuple):
    """A model and a log: motion of the motors and their torques, (samples, n) each, and where they move."""

    robot: Robot
    q: FloatArray
    v: FloatArray
    a: FloatArray
    torque: FloatArray
    moving: FloatArray


class _Change(NamedTuple):
    """A cause with its numbers: the case in which it is corrected, and the starts of their search."""

    name: str
    joints: tuple[int, ...]
    correct: Callable[[FloatArray], _Case]
    words: Callable[[FloatArray], str]
    starts: tuple[tuple[float, ...], ...] = ((),)
    value: Callable[[FloatArray], float | None] = lambda x: float(x[0]) if x.size else None

    def cost(self, left: float, x: FloatArray) -> float:
        """Return the squares that are left, of more numbers as if they were more.

        A base counts as none: a zero off by half a turn predicts what one upside down does.
        """
        return left * _SIMPLER ** (0 if self.name == "base" else x.size)


def find_robot_cause(robot: Robot, records: Sequence[Record], filtering: Filtering) -> RobotCause | None:
    """Return the cause that explains most of the residual of IDIM of rigid joints; None where none explains enough."""
    if len(robot) < _TWO:
        return None
    declared = _thin(robot, records, filtering)
    solve = _Solver(declared)
    ends = list[tuple[float, FloatArray, _Change]]()
    for change in _changes(declared):
        tried = [(solve.left(change.correct(one)), one) for one in map(np.array, change.starts)]
        ends.append((*min(tried, key=lambda one: one[0]), change))
    ends.sort(key=lambda one: one[0])
    free = [one for one in ends if one[1].size]
    free = [*free[:_BEST], *(one for one in free[_BEST:] if one[2].name in _FROM_DECLARED)]
    found = [one for one in ends if not one[1].size]
    found += [(*solve.descend(change.correct, start), change) for _, start, change in free]
    found = [one for one in found if one[2].name != "geometry" or np.max(np.abs(one[1])) < _LONGEST]
    least, x, change = min(found, key=lambda one: one[2].cost(one[0], one[1]))
    if len(robot) - least < _LEAST:
        return None
    joints = tuple(robot.names[k] for k in change.joints)
    return RobotCause(change.name, joints, change.words(x), change.value(x), len(robot) - least)


def find_copied_reference(robot: Robot, records: Sequence[Record]) -> RobotCause | None:
    """Return the joints whose logged position is their reference to rounding; None without any."""
    names = []
    for name, record in zip(robot.names, records, strict=True):
        asked, motor = record.reference, record.motor_position
        if asked is not None and motor is not None and asked.values.shape == motor.values.shape:
            apart, travel = np.max(np.abs(asked.values - motor.values)), np.ptp(asked.values)
            names += [name] if apart <= _SAME * travel and travel > 0.0 else []
    if not names:
        return None
    words = f"the motor position of {join(names)} is its reference: log what the encoder measures"
    return RobotCause("reference_is_position", tuple(names), words)


def find_wrong_sign(names: Sequence[str], driving: Sequence[int]) -> RobotCause | None:
    """Return the joint that its friction drives most, whose torque has the wrong sign; None without any."""
    if not driving:
        return None
    name = names[driving[0]]
    return RobotCause("torque_sign", (name,), _SIGN.format(joint=name))


def _thin(robot: Robot, records: Sequence[Record], filtering: Filtering) -> _Case:
    """Return the declared case at some hundred instants, the torques through the filter of the positions."""
    motion = motion_of_robot(robot, records, filtering)
    assert motion.filtering.position_cutoff is not None
    torque = lowpass(motion.torque, motion.filtering.position_cutoff, motion.sample_time)
    rows = np.arange(len(torque))[motion.inside]
    rows = rows[:: max(rows.size // _INSTANTS, 1)]
    q, v, a = (one[rows] @ robot.coupling.T for one in (motion.q, motion.v, motion.a))
    moving = motion.moving[rows] * (np.abs(v) > _REST * np.max(np.abs(v), axis=0))
    return _Case(robot, q, v, a, torque[rows], moving)


class _Solver:
    """Least squares of all cases, each joint's rows by the size of its error as declared."""

    def __init__(self, declared: _Case) -> None:
        # Of any gravity and coupling: some of these columns are sums of others then.
        robot = declared.robot
        self.parameters = robot_parameters(replace(robot.rigid, gravity=np.array([3.0, 5.0, -7.0])), whole=False)
        self.sizes = np.ones(len(robot))
        for _ in range(3):
            error = self.error(declared).reshape(len(robot), -1)
            self.sizes *= np.maximum(np.linalg.norm(error, axis=1), 1e-6)

    def error(self, case: _Case) -> FloatArray:
        """Return the residual, joint after joint, in units of that of the declared case."""
        q, v, a = (one @ np.linalg.inv(case.robot.coupling).T for one in (case.q, case.v, case.a))
        rotors = inverse_columns(case.robot, q, v, a)[:, :, -len(case.robot) :]
        columns = [self.parameters.columns(case.robot, q, v, a), rotors]
        W = np.concatenate(columns, axis=2) * case.moving[:, :, np.newaxis]
        Y = case.torque * case.moving
        by = self.sizes * np.maximum(np.linalg.norm(Y, axis=0), np.finfo(float).tiny)
        W = (W / by[:, np.newaxis]).transpose(1, 0, 2).reshape(Y.size, -1)
        y = (Y / by).T.ravel()
        W = W / np.maximum(np.linalg.norm(W, axis=0), np.finfo(float).tiny)
        return np.asarray(y - W @ (np.linalg.pinv(W.T @ W, rcond=_RANK, hermitian=True) @ (W.T @ y)))

    def left(self, case: _Case) -> float:
        """Return the squares that are left."""
        return float(np.sum(self.error(case) ** 2))

    def descend(self, correct: Callable[[FloatArray], _Case], x: FloatArray) -> tuple[float, FloatArray]:
        """Return the least squares from a start, by a few steps, and its numbers."""
        from scipy.optimize import least_squares

        def error(x: FloatArray) -> FloatArray:
            return self.error(correct(x))

        found = least_squares(error, x, max_nfev=_STEPS)
        return 2.0 * float(found.cost), found.x


def _changes(declared: _Case) -> Iterator[_Change]:
    """Yield all causes: of the log, of one joint after the other, and of the model."""
    names, own = declared.robot.names, [*range(len(declared.robot))]
    for i, j in itertools.combinations(own, 2):
        other = [j if k == i else i if k == j else k for k in own]
        for code, positions, torques, words in _OF_PAIRS:
            yield _arrange(
                declared, code, (i, j), other if positions else own, other if torques else own,
                words.format(names[i], names[j]),
            )  # fmt: skip
    first = sorted(own, key=names.__getitem__)
    orders = {tuple(own[::-1]), tuple(map(first.index, own)), *((*own[by:], *own[:by]) for by in own[1:])}
    for order in sorted(one for one in orders if sum(k != at for k, at in enumerate(one)) > _TWO):
        said = f"the columns of {join([names[k] for k in order])} are of {join(names)}"
        words = f"the log has the joints in another order: {said}"
        yield _arrange(declared, "order", tuple(own), order, order, words)
    for k in own:
        for row in _OF_JOINTS:
            yield _scale(declared, k, *row)
        yield from _changes_of_link(declared, k)
    yield _hang(declared)
    follows = np.linalg.inv(declared.robot.coupling)
    for i, j in itertools.permutations(own, 2):
        # Where joint j moves with motor i, some factor would leave a joint that no motor moves.
        if abs(i - j) == 1 and not declared.robot.joints[i].coupling and abs(follows[j, i]) < _RANK:
            yield _couple(declared, i, j)


def _arrange(
    declared: _Case, name: str, joints: tuple[int, ...], positions: Sequence[int], torques: Sequence[int], words: str
) -> _Change:
    """Return the change of a log whose columns are in other orders."""
    at, (robot, q, v, a, torque, moving) = list(positions), declared
    case = _Case(robot, q[:, at], v[:, at], a[:, at], torque[:, list(torques)], moving[:, at])

    def correct(_: FloatArray) -> _Case:
        return case

    def say(_: FloatArray) -> str:
        return words

    return _Change(name, joints, correct, say)


def _scale(
    declared: _Case, k: int, name: str, position: int, torque: int, starts: tuple[float, ...], words: str
) -> _Change:
    """Return the change of a log whose position and torque of a joint are off by powers of a factor."""

    def correct(x: FloatArray) -> _Case:
        factor, by = math.exp(x[0]) if x.size else -1.0, np.ones((2, len(declared.robot)))
        by[:, k] = factor**position, factor**torque
        robot, q, v, a, tau, moving = declared
        return _Case(robot, q * by[0], v * by[0], a * by[0], tau * by[1], moving)

    def value(x: FloatArray) -> float | None:
        return math.exp(-x[0]) if x.size else None

    def say(x: FloatArray) -> str:
        return words.format(joint=declared.robot.names[k], value=number(value(x), 3))

    return _Change(name, (k,), correct, say, tuple((one,) for one in starts) or ((),), value)


def _changes_of_link(declared: _Case, k: int) -> Iterator[_Change]:
    """Yield the zero of a joint's encoder, and the place of its link on the one before it."""
    robot, name, at = declared.robot, declared.robot.names[k], declared.robot.links[k].origin

    def wrap(x: FloatArray) -> float:
        return float((x[0] + math.pi) % (2 * math.pi) - math.pi)

    if robot.links[k].kind == "revolute":
        yield _Change(
            "zero", (k,), lambda x: declared._replace(robot=robot.turn(x[0] * np.eye(len(robot))[k])),
            lambda x: f"the encoder of {name} reads 0 where the joint of the model is near {number(wrap(x), 2)} "
            "rad: check it, and give its zero in its table", tuple((one,) for one in _ZEROS), wrap,
        )  # fmt: skip

    def lengthen(x: FloatArray) -> _Case:
        links = list(robot.links)
        links[k] = replace(links[k], origin=at + x)
        return declared._replace(robot=replace(robot, links=tuple(links)))

    def say(x: FloatArray) -> str:
        before, after = (", ".join(f"{float(one):.3f}" for one in place) for place in (at, at + x))
        said = f"{name} stands at {before} m on the link before it, and the torques fit {after} m"
        return f"the geometry of the model is not that of the robot: {said}: check the model's lengths"

    if k:
        yield _Change("geometry", (k,), lengthen, say, ((0.0, 0.0, 0.0),), lambda x: float(np.linalg.norm(x)))


def _hang(declared: _Case) -> _Change:
    """Return the change of the base, or the gravity that a model has not."""
    robot, known = declared.robot, float(np.linalg.norm(declared.robot.gravity))
    size = known or _GRAVITY

    def hang(x: FloatArray) -> _Case:
        return declared._replace(robot=replace(robot, gravity=size * x / np.linalg.norm(x)))

    def say(x: FloatArray) -> str:
        x, y, z = hang(x).robot.gravity
        if not known:
            return f"the links weigh something, and the model has no gravity: give it {x:.2f}, {y:.2f}, {z:.2f} m/s2"
        how = f"stands so that gravity points along {x / size:.2f}, {y / size:.2f}, {z / size:.2f}"
        if min(z, -robot.gravity[2]) > _OPPOSITE * size:
            how = "hangs upside down"
        return f"the base {how} in the model's frame: declare it as robot.base (roll, pitch, yaw)"

    def turned(x: FloatArray) -> float:
        cosine = float(hang(x).robot.gravity @ robot.gravity) / size**2
        return math.acos(min(max(cosine, -1.0), 1.0)) if known else size

    starts = tuple(map(tuple, (*np.eye(3), *-np.eye(3))))
    return _Change("base" if known else "gravity", (), hang, say, starts, turned)


def _couple(declared: _Case, motor: int, joint: int) -> _Change:
    """Return the change of a motor that turns with another joint."""
    robot, (one, other) = declared.robot, (declared.robot.names[k] for k in (motor, joint))

    def couple(x: FloatArray) -> _Case:
        joints = list(robot.joints)
        joints[motor] = replace(joints[motor], coupling={other: float(x[0])})
        return declared._replace(robot=replace(robot, joints=tuple(joints)))

    def say(x: FloatArray) -> str:
        declare = f"coupling = {{ {other} = {number(x[0], 3)} }}"
        return f"the motor of {one} turns with {other}: declare {declare} for {one}"

    return _Change("coupled", (motor, joint), couple, say, tuple((x,) for x in _COUPLED))
