"""Signature of a ripple that a joint has and its model has not: the period with which the residual comes back.

The residual is regressed on cosine and sine of the simulated position over many periods at once: a loop that holds its
position against a force shows it nearly as it is. The likeliest of them are then simulated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.fault_signature import FaultSignature
from jointid.diagnostics.mechanics_faults import COGGING, with_joint
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.joints import FlexibleJoint
from jointid.models.ripple import PositionHarmonics

_FEWEST, _MOST, _STEP = 3.0, 150.0, 0.5  # times that it comes back over the travel
_AT_ONCE = 32  # periods that are regressed on together
_LIKELIEST = 4  # that are simulated
_SMALL = 0.01  # of the torque: how large a ripple is simulated


def find_cogging(
    problem: ClosedLoopProblem,
    x: FloatArray,
    residual: FloatArray,
    own: FloatArray,
    whiten: Callable[[FloatArray], FloatArray],
) -> FaultSignature | None:
    """Return the signature of the ripple that a residual shows most, per unit of its amplitude; None where it has none.

    Args:
        problem: of a flexible joint that may have a ripple, solved.
        x: (free,) its parameters.
        residual: (rows,) of it.
        own: (rows, columns) by its free parameters, and of what was corrected.
        whiten: makes both white.
    """
    joint, run = problem.joint, problem.simulate(x)
    travel = float(np.ptp(run.motor_position))
    if not isinstance(joint, FlexibleJoint) or joint.stepped or not travel > 0.0:
        return None
    basis = np.linalg.qr(whiten(own))[0]

    def beside(columns: FloatArray) -> FloatArray:
        white = whiten(columns)
        return np.asarray(white - basis @ (basis.T @ white))

    left = beside(residual)
    samples = run.motor_position.size
    at_rows = np.linspace(0, samples - 1, residual.size)
    position = np.interp(at_rows, np.arange(samples), run.motor_position)
    waves = np.arange(_FEWEST, _MOST, _STEP) / travel
    gains = np.concatenate(
        [_gains(some, position, left, beside) for some in np.array_split(waves, waves.size // _AT_ONCE)]
    )
    found = [_simulated(problem, x, 1 / waves[k], left, beside, waves.size) for k in np.argsort(-gains)[:_LIKELIEST]]
    return max((one for one in found if one is not None), key=lambda one: one[0], default=(0.0, None))[1]


def _gains(
    waves: FloatArray, position: FloatArray, left: FloatArray, beside: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Return by how much the squares of a residual, (rows,), fall with a force of each wave, (waves,)."""
    phases = 2 * np.pi * np.outer(position, waves)
    cosine, sine = beside(np.cos(phases)), beside(np.sin(phases))
    square, other, both = np.sum(cosine**2, axis=0), np.sum(sine**2, axis=0), np.sum(cosine * sine, axis=0)
    along, across = cosine.T @ left, sine.T @ left
    determinant = np.maximum(square * other - both**2, np.finfo(float).tiny)
    return np.asarray((other * along**2 - 2 * both * along * across + square * across**2) / determinant)


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
        raw = np.column_stack([(other.torque(other.vector({**values, **one})) - base) / size for one in forces])
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
