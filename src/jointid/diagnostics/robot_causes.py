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
from functools import partial

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import join, number
from jointid.estimation.robots.regression import motion_of_robot
from jointid.models.robots.base_parameters import base_parameters, inverse_columns
from jointid.models.robots.friction_terms import friction_columns
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, lowpass

_INSTANTS = 200
_RANK = 1e-12  # of the normal matrix, whose columns have length 1
_LEAST = 0.5  # of the squares of one joint's residual: what a cause explains at least
_SIMPLER = 1.25  # times: so much more may be left by a cause with one free number less
_BEST = 4  # causes whose numbers are searched, beside those that begin at what is declared:
_FROM_DECLARED = ("base", "geometry")
_STEPS, _STEP, _SHOWN = 4, 1e-4, 1e-3  # of a descent; of its largest slope, below which none is more than rounding
_FAR = 0.5  # rad, m, or the logarithm of a factor: the longest step
_TWO = 2  # joints: one alone has none of these causes
_SAME = 1e-9  # of the travel
_REST = 0.02  # of the largest speed: below, Coulomb friction is left out
_ZEROS = tuple(np.pi / 6 * k for k in range(-5, 7) if k)  # rad
_GEARS = tuple(math.log(one) for one in (0.1, 0.3, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0, 10.0))
_UNITS = (math.log(180 / math.pi), -math.log(180 / math.pi), math.log(1e3), -math.log(1e3))
_COUPLED = (-1.0, -0.5, 0.5, 1.0)
_GRAVITY = 9.81  # m/s2
_OPPOSITE = 0.999  # of the cosine: of gravity that is said to be upside down
_SIGN = "the torque of {} has the wrong sign: set torque.sign = -1 in joints.channels, or in record.channels"
_LONGEST = 1.0  # m: a longer correction of a length is none


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
    value: float | None
    explained: float

    def __str__(self) -> str:
        return self.words


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """A model and a log: motion of the motors and their torques, (samples, n) each, and where they move."""

    robot: Robot
    q: FloatArray
    v: FloatArray
    a: FloatArray
    torque: FloatArray
    moving: FloatArray

    def scale(self, joint: int, position: float, torque: float) -> _Case:
        """Return the case with position and torque of a joint times these factors."""
        of_q, of_torque = np.ones((2, len(self.robot)))
        of_q[joint], of_torque[joint] = position, torque
        return replace(
            self, q=self.q * of_q, v=self.v * of_q, a=self.a * of_q, torque=self.torque * of_torque
        )  # fmt: skip

    def arrange(self, positions: Sequence[int], torques: Sequence[int]) -> _Case:
        """Return the case with the columns of the log in these orders."""
        at, of = list(positions), list(torques)
        return _Case(
            self.robot, self.q[:, at], self.v[:, at], self.a[:, at], self.torque[:, of], self.moving[:, at]
        )  # fmt: skip

    def under(self, robot: Robot) -> _Case:
        """Return the case of another model."""
        return replace(self, robot=robot)


@dataclass(frozen=True, slots=True, eq=False)
class _Cause:
    """A cause with its numbers: the starts of the search, and the case in which it is corrected."""

    name: str
    joints: tuple[int, ...]
    correct: Callable[[FloatArray], _Case]
    words: Callable[[FloatArray], str]
    starts: tuple[tuple[float, ...], ...] = ((),)
    value: Callable[[FloatArray], float | None] = lambda x: float(x[0]) if x.size else None

    def count(self, x: FloatArray) -> int:
        """Return the free numbers; none of a base, as a zero off by half a turn predicts what one upside down does."""
        return 0 if self.name == "base" else x.size


def find_robot_cause(robot: Robot, records: Sequence[Record], filtering: Filtering) -> RobotCause | None:
    """Return the cause that explains most of the residual of IDIM, or None.

    It is None where no cause explains enough.

    Args:
        robot: as declared, of rigid joints.
        records: of each joint, with torque and motor position.
        filtering: of positions and rows, resolved.

    Raises:
        RecordError, MethodError: as of IDIM.
    """
    if len(robot) < _TWO:
        return None
    declared = _thin(robot, records, filtering)
    solve = _Solver(declared)
    n, ends = len(robot), list[tuple[float, FloatArray, _Cause]]()
    for cause in _causes(declared):
        starts = [np.array(one) for one in cause.starts]
        left = [solve.left(cause.correct(one)) for one in starts]
        best = int(np.argmin(left))
        ends.append((left[best], starts[best], cause))
    ends.sort(key=lambda one: one[0])
    free = [one for one in ends if one[1].size][:_BEST]
    free += [one for one in ends if one[2].name in _FROM_DECLARED and not any(one is other for other in free)]
    found = [one for one in ends if not one[1].size]
    found += [(*solve.descend(cause.correct, start), cause) for _, start, cause in free]
    found = [one for one in found if one[2].name != "geometry" or np.max(np.abs(one[1])) < _LONGEST]
    least, x, cause = min(found, key=lambda one: one[0] * _SIMPLER ** one[2].count(one[1]))
    if n - least < _LEAST:
        return None
    joints = tuple(robot.names[k] for k in cause.joints)
    return RobotCause(cause.name, joints, cause.words(x), cause.value(x), n - least)


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
    words = (
        f"the motor position of {join(names)} is its reference: log what the encoder measures, not what was asked for"
    )
    return RobotCause("reference_is_position", tuple(names), words, None, math.inf)


def find_wrong_sign(names: Sequence[str], driving: Sequence[int]) -> RobotCause | None:
    """Return the first of the joints that their friction drives, whose torque has the wrong sign; None without any."""
    if not driving:
        return None
    name = names[driving[0]]
    return RobotCause("torque_sign", (name,), _SIGN.format(name), None, math.inf)


def _thin(robot: Robot, records: Sequence[Record], filtering: Filtering) -> _Case:
    """Return the declared case at some hundred instants, the torques through the filter of the positions."""
    motion = motion_of_robot(robot, records, filtering)
    assert motion.filtering.position_cutoff is not None
    torque = lowpass(motion.torque, motion.filtering.position_cutoff, motion.sample_time)
    rows = np.arange(len(torque))[motion.inside]
    rows = rows[:: max(rows.size // _INSTANTS, 1)]
    coupling = robot.coupling.T
    q, v, a = (one[rows] @ coupling for one in (motion.q, motion.v, motion.a))
    moving = motion.moving[rows] * (np.abs(v) > _REST * np.max(np.abs(v), axis=0))
    return _Case(robot, q, v, a, torque[rows], moving)


class _Solver:
    """Least squares of all cases, each joint's rows by the size of its error as declared."""

    def __init__(self, declared: _Case) -> None:
        # Of any gravity and coupling: some of these columns are sums of others then.
        robot = declared.robot
        self.chosen = base_parameters(replace(robot, gravity=np.array([3.0, 5.0, -7.0]))).chosen
        self.chosen = np.union1d(self.chosen, np.arange(10 * len(robot), 11 * len(robot)))
        self.sizes = np.ones(len(robot))
        for _ in range(3):
            error = self.error(declared).reshape(len(robot), -1)
            self.sizes *= np.maximum(np.linalg.norm(error, axis=1), 1e-6)

    def error(self, case: _Case) -> FloatArray:
        """Return the residual, joint after joint, in units of that of the declared case."""
        q, v, a = (one @ np.linalg.inv(case.robot.coupling).T for one in (case.q, case.v, case.a))
        columns = [inverse_columns(case.robot, q, v, a)[:, :, self.chosen], friction_columns(case.robot, v)]
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
        """Return the least squares from a start, by the steps of Gauss and Newton, and its numbers."""
        error = self.error(correct(x))
        for _ in range(_STEPS):
            ahead = [self.error(correct(x + step)) for step in _STEP * np.eye(x.size)]
            slopes = (np.array(ahead) - error).T / _STEP
            move, before = -np.linalg.lstsq(slopes, error, rcond=_SHOWN)[0], float(error @ error)
            for half in (1.0, 0.5, 0.25):
                tried = self.error(correct(x + half * np.clip(move, -_FAR, _FAR)))
                if float(tried @ tried) < before:
                    x, error = x + half * np.clip(move, -_FAR, _FAR), tried
                    break
            if float(error @ error) > 0.999 * before:
                break
        return float(error @ error), x


def _causes(declared: _Case) -> Iterator[_Cause]:
    """Yield all causes."""
    robot, n = declared.robot, len(declared.robot)
    names, own = robot.names, tuple(range(n))
    for i, j in itertools.combinations(range(n), 2):
        other = tuple(j if k == i else i if k == j else k for k in own)
        both = f"{names[i]} and {names[j]} are exchanged"
        yield _Cause(
            "swapped_channels", (i, j), partial(_arrange, declared, own, other),
            partial(_say, f"the torques of {both}: exchange the columns"),
        )  # fmt: skip
        yield _Cause(
            "order", (i, j), partial(_arrange, declared, other, other),
            partial(_say, f"the logs of {both}: give each joint the columns of the other"),
        )  # fmt: skip
        yield _Cause(
            "swapped_positions", (i, j), partial(_arrange, declared, other, own),
            partial(_say, f"the positions of {both}: exchange the columns"),
        )  # fmt: skip
    for order in _orders(names):
        said = f"the columns of {join([names[k] for k in order])} are of {join(names)}"
        yield _Cause(
            "order", own, partial(_arrange, declared, order, order),
            partial(_say, f"the log has the joints in another order: {said}"),
        )  # fmt: skip
    for k in own:
        yield from _causes_of_joint(declared, k)
    yield from _causes_of_model(declared)


def _arrange(declared: _Case, positions: Sequence[int], torques: Sequence[int], _: FloatArray) -> _Case:
    return declared.arrange(positions, torques)


def _say(words: str, _: FloatArray) -> str:
    return words


def _orders(names: Sequence[str]) -> Iterator[tuple[int, ...]]:
    """Yield the orders of a log's columns that are tried: reversed, rotated, alphabetical."""
    n = len(names)
    found = {tuple(range(n))[::-1]} | {tuple((k + by) % n for k in range(n)) for by in range(1, n)}
    first = sorted(range(n), key=names.__getitem__)
    found.add(tuple(first.index(k) for k in range(n)))
    yield from sorted(order for order in found if sum(k != at for k, at in enumerate(order)) > 2)


def _causes_of_joint(declared: _Case, k: int) -> Iterator[_Cause]:
    robot, name = declared.robot, declared.robot.names[k]
    yield _Cause("torque_sign", (k,), lambda x: declared.scale(k, 1.0, -1.0), partial(_say, _SIGN.format(name)))
    yield _Cause(
        "log_gain", (k,), lambda x: declared.scale(k, 1.0, math.exp(x[0])),
        lambda x: f"the logged torque of {name} is {number(math.exp(-x[0]), 3)} times what moves it: check its unit",
        tuple((one,) for one in _GEARS), lambda x: math.exp(-x[0]),
    )  # fmt: skip
    yield _Cause(
        "position_sign", (k,), lambda x: declared.scale(k, -1.0, 1.0),
        lambda x: f"the position of {name} has the wrong sign: set motor_position.sign = -1 in its joints.channels",
    )  # fmt: skip
    yield _Cause(
        "joint_sign", (k,), lambda x: declared.scale(k, -1.0, -1.0),
        lambda x: f"position and torque of {name} count the other way than the model's axis: set "
        "motor_position.sign and torque.sign = -1 in its joints.channels",
    )  # fmt: skip
    yield _Cause(
        "gear_ratio", (k,), lambda x: declared.scale(k, math.exp(x[0]), math.exp(-x[0])),
        lambda x: f"the gear of {name} has {number(math.exp(-x[0]), 3)} times the declared ratio: position and torque "
        "are off by it",
        tuple((one,) for one in _GEARS), lambda x: math.exp(-x[0]),
    )  # fmt: skip
    yield _Cause(
        "position_scale", (k,), lambda x: declared.scale(k, math.exp(x[0]), 1.0),
        lambda x: f"the position of {name} is {number(math.exp(-x[0]), 3)} times what moves the links: check its unit "
        "and its ratio",
        tuple((one,) for one in (*_GEARS, *_UNITS)), lambda x: math.exp(-x[0]),
    )  # fmt: skip
    if robot.links[k].kind == "revolute":
        yield _Cause(
            "zero", (k,), lambda x: declared.under(robot.turn(x[0] * np.eye(len(robot))[k])),
            lambda x: f"the encoder of {name} reads 0 where the joint of the model is near {number(_wrap(x[0]), 2)} "
            "rad: check it, and give its zero in its table",
            tuple((one,) for one in _ZEROS), lambda x: _wrap(x[0]),
        )  # fmt: skip


def _wrap(angle: float) -> float:
    return float((angle + math.pi) % (2 * math.pi) - math.pi)


def _causes_of_model(declared: _Case) -> Iterator[_Cause]:
    robot, n, known = declared.robot, len(declared.robot), float(np.linalg.norm(declared.robot.gravity))
    size = known or _GRAVITY

    def hang(x: FloatArray) -> _Case:
        return declared.under(replace(robot, gravity=size * x / np.linalg.norm(x)))

    def say_base(x: FloatArray) -> str:
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

    yield _Cause(
        "base" if known else "gravity", (), hang, say_base, tuple(map(tuple, (*np.eye(3), *-np.eye(3)))), turned
    )  # fmt: skip
    follows = np.linalg.inv(robot.coupling)
    for i, j in itertools.permutations(range(n), 2):
        # Where joint j moves with motor i, some factor would leave a joint that no motor moves.
        if abs(i - j) == 1 and not robot.joints[i].coupling and abs(follows[j, i]) < _RANK:
            yield _Cause(
                "coupled", (i, j), partial(_couple, declared, i, j),
                partial(_describe_coupling, robot.names[i], robot.names[j]), tuple((one,) for one in _COUPLED),
            )  # fmt: skip
    for k in range(1, n):
        yield _Cause(
            "geometry", (k,), partial(_lengthen, declared, k), partial(_describe_length, robot, k),
            ((0.0, 0.0, 0.0),), lambda x: float(np.linalg.norm(x)),
        )  # fmt: skip


def _couple(declared: _Case, motor: int, joint: int, x: FloatArray) -> _Case:
    joints = list(declared.robot.joints)
    joints[motor] = replace(joints[motor], coupling={declared.robot.names[joint]: float(x[0])})
    return declared.under(replace(declared.robot, joints=tuple(joints)))


def _describe_coupling(motor: str, joint: str, x: FloatArray) -> str:
    declare = f"coupling = {{ {joint} = {number(x[0], 3)} }}"
    return f"the motor of {motor} turns with {joint}: declare {declare} for {motor}"


def _lengthen(declared: _Case, link: int, x: FloatArray) -> _Case:
    links = list(declared.robot.links)
    links[link] = replace(links[link], origin=links[link].origin + x)
    return declared.under(replace(declared.robot, links=tuple(links)))


def _describe_length(robot: Robot, link: int, x: FloatArray) -> str:
    at = robot.links[link].origin
    before, after = (", ".join(f"{float(one):.3f}" for one in place) for place in (at, at + x))
    return (
        f"the geometry of the model is not that of the robot: {robot.names[link]} stands at {before} m on the link "
        f"before it, and the torques fit {after} m: check the model's lengths"
    )
