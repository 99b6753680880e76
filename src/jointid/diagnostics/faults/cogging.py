"""Signature of a ripple that a joint has and its model has not: the period with which the residual comes back.

The residual is regressed on cosine and sine of the simulated position over many periods at once: a loop that holds its
position against a force shows it nearly as it is. The likeliest of them are then simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Hint, Measure, words
from jointid.diagnostics.faults.findings import Finding, LoopCheck
from jointid.diagnostics.faults.trials import with_joint
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.ripple import PositionHarmonics
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.simulated import require_success
from jointid.uncertainty.verdict import Reason

_FEWEST, _MOST, _STEP = 3.0, 150.0, 0.5  # times that it comes back over the travel
_FINER = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # steps from the best, that are simulated, too
_BROAD = 1.0  # how broad a peak is, in times over the travel
_RIDGE = 1e-9  # of the squares: at one direction alone both pairs are the same
_AT_ONCE = 32  # periods that are regressed on together
_LIKELIEST = 6  # that are simulated
_SMALL = 0.01  # of the torque: how large a ripple is simulated


def _search_cogging(problem: ClosedLoopProblem, x: FloatArray, hint: Hint) -> list[FaultSignature]:
    """Return the signature of the ripple that a residual shows most, per unit of its amplitude; nothing without one."""
    run = problem.simulate(x)
    travel = float(np.ptp(run.motor_position))
    if not _may_cog(problem.joint) or not travel > 0.0:
        return []
    basis = np.linalg.qr(hint.whiten(hint.own))[0]

    def beside(columns: FloatArray) -> FloatArray:
        white = hint.whiten(columns)
        return np.asarray(white - basis @ (basis.T @ white))

    left, position = beside(hint.residual), run.motor_position[problem.kept]
    way = np.sign(run.motor_velocity[problem.kept])
    waves = np.arange(_FEWEST, _MOST, _STEP) / travel
    some = np.array_split(waves, waves.size // _AT_ONCE)
    gains = np.concatenate([_gains(one, position, way, left, beside) for one in some])

    def simulate(wave: float) -> tuple[float, FaultSignature] | None:
        return _simulated(problem, x, 1 / wave, left, beside, waves.size)

    peaks = []
    for _ in range(_LIKELIEST):
        peaks.append(float(waves[int(np.argmax(gains))]))
        gains[np.abs(waves - peaks[-1]) < _BROAD / travel] = 0.0  # the same peak
    found = [one for one in in_threads(simulate, peaks) if one is not None]
    if not found:
        return []
    best = 1 / (max(found, key=lambda one: one[0])[1].shape or 1.0)
    finer = best + _STEP / travel * np.array(_FINER)
    found += [one for one in in_threads(simulate, finer.tolist()) if one is not None]
    return [max(found, key=lambda one: one[0])[1]]


def _may_cog(joint: Joint) -> bool:
    """Return True of a flexible joint that may have a ripple; beside smooth laws none is looked for."""
    if not isinstance(joint, FlexibleJoint) or joint.stepped:
        return False
    try:
        replace(joint, ripple=PositionHarmonics(1.0))
    except MethodError:
        return False
    return True


def _gains(
    waves: FloatArray,
    position: FloatArray,
    way: FloatArray,
    left: FloatArray,
    beside: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return by how much the squares of a residual, (rows,), fall with a force of each wave, (waves,).

    A loop shows a force late: behind it on the way there, before it on the way back. So cosine and sine of each
    direction, (rows,), have sizes of their own.
    """
    phases = 2 * np.pi * np.outer(position, waves)
    both = np.cos(phases), np.sin(phases)
    columns = np.stack([beside(one) for one in (*both, *(way[:, np.newaxis] * one for one in both))], axis=2)
    squares = np.einsum("rwi,rwj->wij", columns, columns)
    along = np.einsum("rwi,r->wi", columns, left)
    ridge = _RIDGE * np.trace(squares, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(4)
    return np.asarray(np.einsum("wi,wi->w", along, np.linalg.solve(squares + ridge, along[:, :, np.newaxis])[:, :, 0]))


def _simulated(
    problem: ClosedLoopProblem,
    x: FloatArray,
    period: float,
    left: FloatArray,
    beside: Callable[[FloatArray], FloatArray],
    tried: int,
) -> tuple[float, FaultSignature] | None:
    """Return by how much the squares fall with a ripple of a period, and its signature; None where it moves nothing."""
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    size = float(np.linalg.norm(problem.measured)) / np.sqrt(problem.measured.size) * _SMALL
    try:
        other = with_joint(problem, replace(joint, ripple=PositionHarmonics(period)))
        values, base = problem.values(x), problem.torque(x)
        names = [p.name for p in other.parameters if p.name.startswith("harmonic_")]
        forces = [dict(zip(names, size * np.array(parts), strict=True)) for parts in ((1.0, 0.0), (0.0, 1.0))]
        runs = [require_success(other.simulate(other.vector({**values, **one}))) for one in forces]
        raw = np.column_stack([(run.torque - base) / size for run in runs])
    except JointidError:  # the joint may have none beside its other laws
        return None
    seen = problem.filtered(raw)
    columns = beside(seen)
    parts = np.linalg.lstsq(columns, left, rcond=None)[0]
    amplitude = float(np.linalg.norm(parts))
    if not amplitude > 0.0:
        return None
    parts = parts / amplitude
    signature = FaultSignature(COGGING, seen @ parts, period, raw @ parts, tried)
    return float(left @ columns @ parts) * amplitude, signature


def _describe_cogging(finding: Finding, check: LoopCheck, spread: bool) -> str:
    s = finding.test
    size = s.show_size(check.on_side("torque"), spread=spread)
    period = f"{number(s.shape, 3)} {check.on_side('position')}"
    return words("a force", size and f"of {size}", "comes back with the motor's position, every", period)


COGGING = Fault(
    "cogging", "force that comes back with the position", describe=_describe_cogging, search=_search_cogging,
    applies=_may_cog, mechanical=True, one_sided=True, measure=Measure.TORQUE,
    reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy=lambda test: f"; to identify it, declare it: [ripple] period = {number(test.shape, 3)}",
)  # fmt: skip

FAULTS = (COGGING,)
