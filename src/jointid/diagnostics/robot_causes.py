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
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import join, number
from jointid.diagnostics.changes import Cause
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
_SIGN = "the torque of {joint} has the wrong sign: turn torque.sign round in joints.channels, or in record.channels"

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
        "the position of {joint} has the wrong sign: turn motor_position.sign round in its joints.channels",
    ),
    (
        "joint_sign", 1, 1, (),
        "position and torque of {joint} count the other way than the model's axis: turn motor_position.sign and "
        "torque.sign round in its joints.channels",
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


class _Case(NamedTuple):
    """A model and a log: motion of the motors and their torques, (samples, n) each, and where they move."""

    robot: Robot
    q: FloatArray
    v: FloatArray
    a: FloatArray
    torque: FloatArray
    moving: FloatArray

    def arranged(self, positions: Sequence[int], torques: Sequence[int]) -> _Case:
        """Return the case with the columns of its log in other orders."""
        at = list(positions)
        q, v, a, moving = (one[:, at] for one in (self.q, self.v, self.a, self.moving))
        return _Case(self.robot, q, v, a, self.torque[:, list(torques)], moving)

    def scaled(self, k: int, position: float, torque: float) -> _Case:
        """Return the case with position and torque of a joint times these."""
        by = np.ones((2, len(self.robot)))
        by[:, k] = position, torque
        q, v, a = (one * by[0] for one in (self.q, self.v, self.a))
        return self._replace(q=q, v=v, a=a, torque=self.torque * by[1])


class _Change(NamedTuple):
    """A mistake with its numbers: the case in which it is corrected, its words and value, and starts of a search."""

    name: str
    joints: tuple[int, ...]
    correct: Callable[[FloatArray], _Case]
    say: Callable[[FloatArray], tuple[str, float | None]]
    starts: Sequence[Sequence[float]] = ((),)

    def cost(self, left: float, x: FloatArray) -> float:
        """Return the squares that are left, of more numbers as if they were more.

        A base counts as none: a zero off by half a turn predicts what one upside down does.
        """
        if self.name == "geometry" and np.max(np.abs(x)) >= _LONGEST:
            return math.inf
        return left * _SIMPLER ** (0 if self.name == "base" else x.size)


def find_robot_cause(robot: Robot, records: Sequence[Record], filtering: Filtering) -> Cause | None:
    """Return the cause that explains most of the residual of IDIM of rigid joints; None where none explains enough."""
    if len(robot) < _TWO:
        return None
    declared = _thin(robot, records, filtering)
    solve = _Solver(declared)

    def left(change: _Change, x: Sequence[float]) -> tuple[float, FloatArray, _Change]:
        return float(np.sum(solve.error(change.correct(np.array(x))) ** 2)), np.array(x), change

    ends = [min((left(change, x) for x in change.starts), key=lambda one: one[0]) for change in _changes(declared)]
    ends.sort(key=lambda one: one[0])
    found, free = [one for one in ends if not one[1].size], [one for one in ends if one[1].size]
    for _, start, change in (*free[:_BEST], *(one for one in free[_BEST:] if one[2].name in _FROM_DECLARED)):
        found.append((*solve.descend(change.correct, start), change))
    least, x, change = min(found, key=lambda one: one[2].cost(one[0], one[1]))
    if len(robot) - least < _LEAST:
        return None
    return Cause(change.name, *change.say(x), least, tuple(robot.names[k] for k in change.joints))


def find_copied_reference(robot: Robot, records: Sequence[Record]) -> Cause | None:
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
    return Cause("reference_is_position", words, joints=tuple(names))


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

    def descend(self, correct: Callable[[FloatArray], _Case], x: FloatArray) -> tuple[float, FloatArray]:
        """Return the least squares from a start, by a few steps, and its numbers."""
        from scipy.optimize import least_squares

        def error(x: FloatArray) -> FloatArray:
            return self.error(correct(x))

        found = least_squares(error, x, max_nfev=_STEPS)
        return 2.0 * float(found.cost), found.x


def _changes(declared: _Case) -> Iterator[_Change]:
    """Yield all changes: of the log, of one joint after the other, and of the model."""
    names, own = declared.robot.names, [*range(len(declared.robot))]

    def arrange(
        name: str, joints: Sequence[int], positions: Sequence[int], torques: Sequence[int], words: str
    ) -> _Change:
        case = declared.arranged(positions, torques)
        return _Change(name, tuple(joints), lambda _: case, lambda _: (words, None))

    for i, j in itertools.combinations(own, 2):
        other = [j if k == i else i if k == j else k for k in own]
        for code, positions, torques, words in _OF_PAIRS:
            said = words.format(names[i], names[j])
            yield arrange(code, (i, j), other if positions else own, other if torques else own, said)
    first = sorted(own, key=names.__getitem__)
    orders = {tuple(own[::-1]), tuple(map(first.index, own)), *((*own[by:], *own[:by]) for by in own[1:])}
    for order in sorted(one for one in orders if sum(k != at for k, at in enumerate(one)) > _TWO):
        said = f"the columns of {join([names[k] for k in order])} are of {join(names)}"
        yield arrange("order", own, order, order, f"the log has the joints in another order: {said}")
    for k in own:
        yield from (_scale(declared, k, *row) for row in _OF_JOINTS)
        yield from _changes_of_link(declared, k)
    yield _hang(declared)
    follows = np.linalg.inv(declared.robot.coupling)
    for i, j in itertools.permutations(own, 2):
        # Where joint j moves with motor i, some factor would leave a joint that no motor moves.
        if abs(i - j) == 1 and not declared.robot.joints[i].coupling and abs(follows[j, i]) < _RANK:
            yield _couple(declared, i, j)


def _scale(
    declared: _Case, k: int, name: str, position: int, torque: int, starts: tuple[float, ...], words: str
) -> _Change:
    """Return the change of a log whose position and torque of a joint are off by powers of a factor."""

    def correct(x: FloatArray) -> _Case:
        factor = math.exp(x[0]) if x.size else -1.0
        return declared.scaled(k, factor**position, factor**torque)

    def say(x: FloatArray) -> tuple[str, float | None]:
        value = math.exp(-x[0]) if x.size else None
        return words.format(joint=declared.robot.names[k], value=number(value, 3)), value

    return _Change(name, (k,), correct, say, tuple((one,) for one in starts) or ((),))


def _changes_of_link(declared: _Case, k: int) -> Iterator[_Change]:
    """Yield the zero of a joint's encoder, and the place of its link on the one before it."""
    robot, name, at = declared.robot, declared.robot.names[k], declared.robot.links[k].origin

    def turn(x: FloatArray) -> _Case:
        return declared._replace(robot=robot.turn(x[0] * np.eye(len(robot))[k]))

    def say_zero(x: FloatArray) -> tuple[str, float]:
        zero = float((x[0] + math.pi) % (2 * math.pi) - math.pi)
        said = f"the encoder of {name} reads 0 where the joint of the model is near {number(zero, 2)} rad"
        return f"{said}: check it, and give its zero in its table", zero

    def lengthen(x: FloatArray) -> _Case:
        links = list(robot.links)
        links[k] = replace(links[k], origin=at + x)
        return declared._replace(robot=replace(robot, links=tuple(links)))

    def say_place(x: FloatArray) -> tuple[str, float]:
        before, after = (", ".join(f"{float(one):.3f}" for one in place) for place in (at, at + x))
        said = f"{name} stands at {before} m on the link before it, and the torques fit {after} m"
        words = f"the geometry of the model is not that of the robot: {said}: check the model's lengths"
        return words, float(np.linalg.norm(x))

    if robot.links[k].kind == "revolute":
        yield _Change("zero", (k,), turn, say_zero, tuple((one,) for one in _ZEROS))
    if k:
        yield _Change("geometry", (k,), lengthen, say_place, ((0.0, 0.0, 0.0),))


def _hang(declared: _Case) -> _Change:
    """Return the change of the base, or the gravity that a model has not."""
    robot, known = declared.robot, float(np.linalg.norm(declared.robot.gravity))
    size = known or _GRAVITY

    def hang(x: FloatArray) -> _Case:
        return declared._replace(robot=replace(robot, gravity=size * x / np.linalg.norm(x)))

    def say(x: FloatArray) -> tuple[str, float]:
        gravity = hang(x).robot.gravity
        towards = ", ".join(f"{one:.2f}" for one in gravity / size)
        if not known:
            return f"the links weigh something, and the model has no gravity: give it {size} m/s2 along {towards}", size
        upside_down = min(gravity[2], -robot.gravity[2]) > _OPPOSITE * size
        how = "hangs upside down" if upside_down else f"stands so that gravity points along {towards}"
        cosine = float(gravity @ robot.gravity) / size**2
        words = f"the base {how} in the model's frame: declare it as robot.base (roll, pitch, yaw)"
        return words, math.acos(min(max(cosine, -1.0), 1.0))

    return _Change("base" if known else "gravity", (), hang, say, (*np.eye(3), *-np.eye(3)))


def _couple(declared: _Case, motor: int, joint: int) -> _Change:
    """Return the change of a motor that turns with another joint."""
    robot, (one, other) = declared.robot, (declared.robot.names[k] for k in (motor, joint))

    def couple(x: FloatArray) -> _Case:
        joints = list(robot.joints)
        joints[motor] = replace(joints[motor], coupling={other: float(x[0])})
        return declared._replace(robot=replace(robot, joints=tuple(joints)))

    def say(x: FloatArray) -> tuple[str, float]:
        declare = f"coupling = {{ {other} = {number(x[0], 3)} }}"
        return f"the motor of {one} turns with {other}: declare {declare} for {one}", float(x[0])

    return _Change("coupled", (motor, joint), couple, say, tuple((x,) for x in _COUPLED))
