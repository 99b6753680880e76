"""Tests of faults along the motion of axes, where each fault adds a column to the torque of one axis.

A fault of one joint's friction adds to that joint's torque alone, and a wrong scale or a delay of one log changes that
joint's torque alone. The other joints show that: they share the inertias of the links. So the rows of all joints are
regressed on the columns of the free parameters and of a fault, each joint by the size of its error. The tests are those
of a joint's loop (`score`). The most significant fault is taken, and the rest is tested again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.diagnostics.axis_torques import ROTORS, AxisTorques
from jointid.diagnostics.faults import AxisFaults, FaultSignature, FaultTest, Finding
from jointid.diagnostics.in_time import find_part
from jointid.diagnostics.score import score
from jointid.diagnostics.search_state import LEVEL, MOST
from jointid.diagnostics.suspects import COMPLIANCE, LOG_GAIN
from jointid.diagnostics.variants import OTHER_LAWS, WHOLE
from jointid.uncertainty.position_dependent_error import cells

_FEWEST = 4  # rows to a column, of each fault one
_MUCH = 0.25  # of what is left of an axis, that a fault explains at least
_SURELY, _NEARLY = 2.0, 0.2  # deviations, and of a change, within which it is whole
_AS_STRONG = 0.8  # of a strength: a fault that is as strong explains nearly as much, and a law of the drive goes first
_TWO = 2  # axes: of one alone no other tells its sign
_DRIVES = 5.0  # times the error, along the velocity
_RANK = 1e-9  # of the largest singular value


def find_axis_faults(
    torques: AxisTorques, units: Sequence[tuple[str, str]], laws: Sequence[tuple[str, ...]]
) -> tuple[tuple[AxisFaults, ...], float]:
    """Return the faults of each axis, and the share of the squares of a residual that they explain, summed up.

    Args:
        torques: of all axes, with the columns of their free parameters.
        units: of position and torque, of each axis.
        laws: of each axis, the names of those that can replace its own.
    """
    rows, own, residual = torques.rows, torques.stack(torques.own), torques.stack(torques.error)
    own, open_ones = own[:, np.any(own, axis=0)], _list_shapes(torques)
    where, basis = cells(*places_of(torques)), orthonormal_basis(own, _RANK)
    before = rest = residual - basis @ (basis.T @ residual)
    found: list[list[Finding]] = [[] for _ in units]
    first: tuple[FaultTest, ...] = ()
    while np.any(residual) and open_ones:
        if residual.size <= _FEWEST * (own.shape[1] + len({(one.axis, one.fault) for one in open_ones})):
            break
        declared = {one.fault: 1.0 if one.fault == LOG_GAIN else 0.0 for one in open_ones}
        tests = score(
            residual, own, open_ones, declared, where, blocks=rows,
            along_measured_motion=torques.along_measured_motion,
        )  # fmt: skip
        first = first or tests
        # What one drive does otherwise moves the other joints: which of them do so, too, is seen once it is declared.
        gone = OTHER_LAWS if any(one.test.name in OTHER_LAWS for each in found for one in each) else ()
        likely = [one for one in tests if one.p_value <= LEVEL and one.name not in gone and len(found[one.axis]) < MOST]
        likely.sort(key=lambda one: -one.strength / (_AS_STRONG if one.name in OTHER_LAWS else 1.0))
        explaining = (
            (one, shape.column)
            for one in likely
            for shape in open_ones
            if (shape.axis, shape.fault, shape.shape) == (one.axis, one.fault, one.shape)
            and (
                abs(one.size - 1.0) < max(_SURELY * one.std, _NEARLY)
                if one.name in WHOLE
                else _gain_of(shape.column, basis, rest) > _MUCH * np.sum(rest[rows[one.axis]] ** 2)
            )
        )
        test, column = next(explaining, (None, None))
        if test is None or column is None:
            break
        rivals = (one for one in likely if one.axis == test.axis and one is not test)
        near = tuple(one for one in rivals if one.strength > _AS_STRONG * test.strength)
        found[test.axis].append(Finding(test, None, near, {}))
        own = np.column_stack([own, column])
        basis = orthonormal_basis(own, _RANK)
        rest = residual - basis @ (basis.T @ residual)
        kin = {test.name, test.fault.kin} - {""}
        open_ones = [one for one in open_ones if one.axis != test.axis or not kin & {one.fault.name, one.fault.kin}]
    parts = [find_part(rest[one], torques.time[seen]) for one, seen in zip(rows, torques.seen, strict=True)]
    faults = tuple(
        AxisFaults(
            () if any(parts) else tuple(found[k]), tuple(one for one in first if one.axis == k), LEVEL, {},
            {"position": position, "velocity": f"{position}/s", "torque": torque}, laws=laws[k], of_loop=False,
            part=parts[k],
        )
        for k, (position, torque) in enumerate(units)
    )  # fmt: skip
    return faults, _explained(before, rest, rows)


def _explained(before: FloatArray, after: FloatArray, rows: Sequence[slice]) -> float:
    """Return by how much the squares of each axis' residual fell, as a sum of their shares, none below 0."""
    squares = np.array([[np.sum(each[one] ** 2) for one in rows] for each in (before, after)])
    begin, end = squares[:, squares[0] > 0.0]
    return float(np.sum(np.maximum(1.0 - end / begin, 0.0)))


def _list_shapes(torques: AxisTorques) -> list[FaultSignature]:
    """Return the faults of each axis that are to be tested.

    A spring is tested by what it makes of all torques, where that is known: rigid axes behind it follow it, too.
    """
    every = range(len(torques.names))
    shapes = [replace(one, axis=k, column=torques.place(k, one.column)) for k in every for one in torques.shapes[k]]
    if len(every) > 1:
        shapes += [FaultSignature(LOG_GAIN, torques.place(k, torques.predicted[k]), axis=k) for k in every]
    shapes = [one for one in shapes if np.any(one.column)]
    if torques.springs is None:
        return shapes
    bends = [
        FaultSignature(COMPLIANCE, torques.stack(column), share, axis=k)
        for k, columns in enumerate(torques.springs)
        for share, column in zip(ROTORS, columns, strict=True)
    ]
    return [*(one for one in shapes if one.fault != COMPLIANCE), *(one for one in bends if np.any(one.column))]


def find_driving_axes(torques: AxisTorques) -> list[int]:
    """Return the axes that their friction drives: its torque along the velocity is clearly negative."""
    if torques.friction is None or len(torques.names) < _TWO:
        return []
    along = np.sum(torques.friction * torques.velocity * torques.seen, axis=1)
    noise = np.sqrt(np.sum(torques.velocity**2 * torques.seen, axis=1) * np.mean(torques.error**2, axis=1))
    return [int(k) for k in np.flatnonzero(along < -_DRIVES * noise)]


def _gain_of(column: FloatArray, basis: FloatArray, rest: FloatArray) -> float:
    """Return by how much a column beside a basis lowers the squares that are left."""
    apart = column - basis @ (basis.T @ column)
    size = float(apart @ apart)
    return float(apart @ rest) ** 2 / size if size > _RANK * float(column @ column) else 0.0


def places_of(torques: AxisTorques) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity in the rows of all axes that are seen, (rows,), for their cells."""
    places = zip(torques.position, torques.velocity, torques.seen, strict=True)
    scaled = [(3.0 * k + _scale(q[seen]), _scale(v[seen])) for k, (q, v, seen) in enumerate(places)]
    where, speed = zip(*scaled, strict=True)
    return np.concatenate(where), np.concatenate(speed)


def _scale(values: FloatArray) -> FloatArray:
    """Return values within 0 and 1 by their range, or of either sign by their largest."""
    return values / (float(np.max(np.abs(values), initial=0.0)) or 1.0)
