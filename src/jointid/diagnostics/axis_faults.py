"""Tests of faults along the motion of axes, where each fault adds a column to the torque of one axis.

A fault of one joint's friction adds to that joint's torque alone, and a wrong scale or a delay of one log changes that
joint's torque alone. The other joints show that: they share the inertias of the links. So the rows of all joints are
regressed on the columns of the free parameters and of a fault, each joint by the size of its error. The tests are those
of a joint's loop (`score`). The most significant fault is taken, and the rest is tested again.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.parallel import in_threads
from jointid.diagnostics.axis_torques import ROTORS, AxisTorques
from jointid.diagnostics.faults.fault import Fault, FaultSignature, FaultTest
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.numbers import LOG_GAIN
from jointid.diagnostics.faults.other_laws import OTHER_LAWS
from jointid.diagnostics.faults.springs import COMPLIANCE
from jointid.diagnostics.in_time import find_part
from jointid.diagnostics.score import score
from jointid.uncertainty.position_dependent_error import cells
from jointid.uncertainty.residual_tests import Coupling, coupling

_MOST = 3  # faults of one axis
_FEWEST = 4  # rows to a column
_FEWEST_ROWS = 100
_MUCH = 0.25  # of what is left of an axis, that a fault explains at least
_TWO = 2  # axes: of one alone no other tells its sign
_DRIVES = 5.0  # times the error, along the velocity
_RANK = 1e-9  # of the largest singular value


Follows: TypeAlias = tuple[str, Coupling] | None
"""What a residual correlates with most, in words."""


class _Shape(NamedTuple):
    """A fault of one axis, and its column among the rows of all axes, (rows,)."""

    axis: int
    fault: Fault
    shape: float | None
    column: FloatArray


def find_axis_faults(
    torques: AxisTorques, units: Sequence[tuple[str, str]], level: float, laws: Sequence[tuple[str, ...]]
) -> tuple[tuple[AxisFaults, ...], tuple[Follows, ...], float]:
    """Return the faults of each axis, its strongest correlation, and the share explained.

    The correlation is that of its residual. The share is that of the squares of a residual which the faults explain,
    summed up over the axes.

    Args:
        torques: of all axes, with the columns of their free parameters.
        units: of position and torque, of each axis.
        level: largest share of records without a fault in which one is found.
        laws: of each axis, the names of those that can replace its own.
    """
    n = len(units)
    seen = torques.seen
    sigma = [
        float(np.sqrt(np.mean(e[s] ** 2))) if np.any(e[s]) else 1.0 for e, s in zip(torques.error, seen, strict=True)
    ]
    ends = np.cumsum([0, *(int(np.count_nonzero(one)) for one in seen)])
    rows = [slice(*pair) for pair in itertools.pairwise(ends)]

    def stack(each: FloatArray) -> FloatArray:
        """Return the rows of all axes that are seen, each by the size of its error."""
        return np.concatenate([part[s] / size for part, s, size in zip(each, seen, sigma, strict=True)])

    def place(axis: int, column: FloatArray) -> FloatArray:
        found = np.zeros(ends[-1])
        found[rows[axis]] = column[seen[axis]] / sigma[axis]
        return found

    own = _drop_idle(stack(torques.own))
    simple, shapes = _list_shapes(torques, place, stack)
    found: list[list[Finding]] = [[] for _ in range(n)]
    first: list[tuple[int, FaultTest]] = []
    where, speed = places_of(torques)
    residual, open_ones = stack(torques.error), shapes
    basis = orthonormal_basis(own, _RANK)
    before = residual - basis @ (basis.T @ residual)
    of_axes = [[one for one in simple if one.axis == k and one.fault != LOG_GAIN] for k in range(n)]
    follows = tuple(in_threads(lambda k: _strongest_coupling(residual, basis, of_axes[k], rows[k]), range(n)))
    while np.any(residual) and _has_enough_rows(residual, own, open_ones):
        keys = {_key_of(one): (one.axis, one.fault) for one in open_ones}
        signatures = [FaultSignature(_key_of(one), one.column, one.shape) for one in open_ones]
        tested = score(
            residual, own, signatures, dict.fromkeys(keys, 0.0), lambda: cells(where, speed), blocks=rows,
            along_measured_motion=torques.along_measured_motion,
        )  # fmt: skip
        tests = [_of_axis(one, keys) for one in tested]
        first = [*first, *tests] if len(first) < n else first
        rest = residual - basis @ (basis.T @ residual)
        likely = (
            (_shape_of(one, k, open_ones), one)
            for k, one in tests
            if one.p_value <= level and one.fault not in OTHER_LAWS  # these are searched for (`axis_laws`)
        )
        best = next(
            (
                (shape, one)
                for shape, one in likely
                if len(found[shape.axis]) < _MOST
                and _gain_of(shape.column, basis, rest) > _MUCH * _squares(rest[rows[shape.axis]])
            ),
            None,
        )
        if best is None:
            break
        (taken, test), axis = best, best[0].axis
        found[axis].append(Finding(test, None, (), {}))
        own = np.column_stack([own, taken.column])
        basis = orthonormal_basis(own, _RANK)
        kin = {test.name, test.fault.kin} - {""}
        open_ones = [o for o in open_ones if o.axis != axis or not kin & {o.fault.name, o.fault.kin}]
    after = residual - basis @ (basis.T @ residual)
    explained = _explained(before, after, rows)
    parts = [find_part(after[rows[k]], torques.time[seen[k]]) for k in range(n)]
    faults = tuple(
        AxisFaults(
            () if any(parts) else tuple(found[k]), tuple(one for at, one in first if at == k), level, {},
            {"position": units[k][0], "velocity": f"{units[k][0]}/s", "torque": units[k][1]}, laws=laws[k],
            of_loop=False, part=parts[k],
        )
        for k in range(n)
    )  # fmt: skip
    return faults, follows, explained


def _key_of(shape: _Shape) -> Fault:
    """Return the fault of one axis alone."""
    return replace(shape.fault, name=f"{shape.axis}.{shape.fault.name}")


def _explained(before: FloatArray, after: FloatArray, rows: Sequence[slice]) -> float:
    """Return by how much the squares of each axis' residual fell, as a sum of their shares, none below 0."""
    squares = [[_squares(each[one]) for one in rows] for each in (before, after)]
    return float(sum(max(1.0 - end / begin, 0.0) for begin, end in zip(*squares, strict=True) if begin > 0.0))


def _list_shapes(
    torques: AxisTorques, place: Callable[[int, FloatArray], FloatArray], stack: Callable[[FloatArray], FloatArray]
) -> tuple[list[_Shape], list[_Shape]]:
    """Return the faults of each axis along its own torque alone, and those to be tested.

    A spring is tested by what it makes of all torques, where that is known: rigid axes behind it follow it, too.
    """
    n = len(torques.names)
    shapes = [
        _Shape(k, one.fault, one.shape, place(k, one.column))
        for k, all_of in enumerate(torques.shapes)
        for one in all_of
    ]
    shapes += [_Shape(k, LOG_GAIN, None, place(k, torques.predicted[k])) for k in range(n) if n > 1]
    shapes = [one for one in shapes if np.any(one.column)]
    if torques.springs is None:
        return shapes, shapes
    bends = [
        _Shape(k, COMPLIANCE, share, stack(column))
        for k, columns in enumerate(torques.springs)
        for share, column in zip(ROTORS, columns, strict=True)
    ]
    return shapes, [*(one for one in shapes if one.fault != COMPLIANCE), *(one for one in bends if np.any(one.column))]


def _squares(values: FloatArray) -> float:
    return float(values @ values)


def _has_enough_rows(residual: FloatArray, own: FloatArray, shapes: Sequence[_Shape]) -> bool:
    """Test whether there are rows enough for the columns, of each fault one shape, and any shape at all."""
    tried = {(one.axis, one.fault) for one in shapes}
    return bool(tried) and residual.size > _FEWEST * (own.shape[1] + len(tried))


def find_driving_axes(torques: AxisTorques) -> list[int]:
    """Return the axes that their friction drives, the clearest first: its torque along the velocity is negative."""
    if torques.friction is None or len(torques.names) < _TWO:
        return []
    along = np.sum(torques.friction * torques.velocity * torques.seen, axis=1)
    noise = np.sqrt(np.sum(torques.velocity**2 * torques.seen, axis=1) * np.mean(torques.error**2, axis=1))
    share = along / np.maximum(noise, np.finfo(float).tiny)
    return [int(k) for k in np.argsort(share) if share[k] < -_DRIVES]


def _of_axis(test: FaultTest, keys: dict[Fault, tuple[int, Fault]]) -> tuple[int, FaultTest]:
    """Return the axis of a test, and the test of its fault there."""
    axis, fault = keys[test.fault]
    alike, opposite = (
        tuple(other for at, other in map(keys.__getitem__, each) if at == axis) for each in (test.alike, test.opposite)
    )
    return axis, replace(test, fault=fault, alike=alike, opposite=opposite, declared=1.0 if fault == LOG_GAIN else 0.0)


def find_follower(torques: AxisTorques) -> Follows:
    """Return the shape that a residual correlates with most, or None."""
    inside = torques.seen[0]
    shapes = [_Shape(0, one.fault, one.shape, one.column[inside]) for one in torques.shapes[0]]
    basis = orthonormal_basis(_drop_idle(torques.own[0][inside]), _RANK)
    return _strongest_coupling(torques.error[0][inside], basis, shapes, slice(None))


def _strongest_coupling(residual: FloatArray, basis: FloatArray, shapes: Sequence[_Shape], rows: slice) -> Follows:
    """Return the fault that an axis' residual correlates with most beside the free parameters, or None."""
    error = residual[rows]
    if error.size < _FEWEST_ROWS or not np.any(error):
        return None
    groups, basis = dict[str, list[FloatArray]](), basis[rows]  # outside its rows the column of an axis is 0
    columns = np.array([one.column[rows] for one in shapes]).reshape(-1, error.size)
    for one, apart in zip(shapes, columns - columns @ basis @ basis.T, strict=True):
        groups.setdefault(one.fault.phrase, []).append(apart)
    found = {phrase: coupling(error, np.column_stack(columns)) for phrase, columns in groups.items()}
    seen = {phrase: one for phrase, one in found.items() if one.seen}
    if not seen:
        return None
    # Beyond chance, not in all: a fault of eight columns explains more of anything than one of one.
    phrase = max(seen, key=lambda one: seen[one].explained - seen[one].by_chance)
    return phrase, seen[phrase]


def _gain_of(column: FloatArray, basis: FloatArray, rest: FloatArray) -> float:
    """Return by how much a column beside a basis lowers the squares that are left."""
    apart = column - basis @ (basis.T @ column)
    size = float(apart @ apart)
    return float(apart @ rest) ** 2 / size if size > _RANK * float(column @ column) else 0.0


def _shape_of(test: FaultTest, axis: int, shapes: Sequence[_Shape]) -> _Shape:
    return next(one for one in shapes if (one.axis, one.fault, one.shape) == (axis, test.fault, test.shape))


def places_of(torques: AxisTorques) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity in the rows of all axes that are seen, (rows,), for their cells."""
    places = zip(torques.position, torques.velocity, torques.seen, strict=True)
    scaled = [(3.0 * k + _scale(q[seen]), _scale(v[seen])) for k, (q, v, seen) in enumerate(places)]
    where, speed = zip(*scaled, strict=True)
    return np.concatenate(where), np.concatenate(speed)


def _drop_idle(columns: FloatArray) -> FloatArray:
    return columns[:, np.any(columns, axis=0)]


def _scale(values: FloatArray) -> FloatArray:
    """Return values within 0 and 1 by their range, or of either sign by their largest."""
    return values / (float(np.max(np.abs(values), initial=0.0)) or 1.0)
