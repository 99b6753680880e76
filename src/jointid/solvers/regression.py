"""Linear least squares by QR, and the projection on columns by others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError

_RANK = 1e-10  # of the largest: a normalised singular value below this is a parameter nothing excites


@dataclass(frozen=True, slots=True)
class Conditioning:
    """The condition number of a regressor, by three definitions.

    Attributes:
        raw: of the columns as they are; depends on the units.
        normalised: of the columns divided by their norms.
        scaled: of the columns multiplied by the estimates: what each parameter contributes to the torque.
    """

    raw: float
    normalised: float
    scaled: float


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The least-squares solution of ``Y = W x``.

    Attributes:
        values: (parameters,) the solution.
        std: (parameters,) standard deviations, for a white residual of `sigma`.
        residual: (rows,) Y - W x.
        sigma: standard deviation of the residual.
        relative_error: ``||Y - W x|| / ||Y||``, a ratio.
        conditioning: of W.
    """

    values: FloatArray
    std: FloatArray
    residual: FloatArray
    sigma: float
    relative_error: float
    conditioning: Conditioning


def least_squares(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> Fit:
    """Solve ``Y = W x`` by QR with column scaling.

    Args:
        W: (rows, parameters).
        Y: (rows,).
        names: of the parameters, for the error.

    The variance of the residual is ``||Y - W x||^2 / (r - b)`` for r rows and b parameters. (The EMPS report takes
    the sample variance, r - 1: a relative difference of (b - 1) / 2r in the deviations, 0.06 % there.)
    """
    rows, count = W.shape
    values, norms, R = _solve(W, Y, names)
    residual = Y - W @ values
    sigma = float(np.linalg.norm(residual) / np.sqrt(rows - count))
    spread = np.linalg.norm(np.linalg.inv(R), axis=1) / norms
    error = float(np.linalg.norm(residual) / np.linalg.norm(Y))
    scale = np.where(values == 0.0, 1.0, np.abs(values))
    conditioning = Conditioning(*(float(np.linalg.cond(R * by)) for by in (norms, 1.0, norms * scale)))
    return Fit(values, sigma * spread, residual, sigma, error, conditioning)


def solution(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Solution of `least_squares`, parameters only, (parameters,)."""
    return _solve(W, Y, names)[0]


def _solve(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the solution, the column norms and the triangle of the scaled columns."""
    rows, count = W.shape
    if rows <= count:
        raise MethodError(
            f"{rows} filtered samples cannot determine {count} parameters; use a longer record or decimate less."
        )
    refuse_idle(W, names)
    norms = np.linalg.norm(W, axis=0)
    Q, R = np.linalg.qr(W / norms)
    _, sizes, directions = np.linalg.svd(R)  # the triangle of columns of norm 1 has their singular values
    if not sizes[-1] > _RANK * sizes[0]:
        involved = [name for name, share in zip(names, directions[-1], strict=True) if abs(share) > 1e-3]
        raise MethodError(
            f"{', '.join(involved)} cannot be distinguished in this record (their columns are collinear); fix one of "
            "them."
        )
    return np.linalg.solve(R, Q.T @ Y) / norms, norms, R


def refuse_idle(columns: FloatArray, names: tuple[str, ...]) -> None:
    """Refuse columns (rows, parameters) of zeros; the sentence names the parameters."""
    norms = np.linalg.norm(columns, axis=0)
    idle = [name for name, norm in zip(names, norms, strict=True) if not norm > 0]
    if idle:
        raise MethodError(
            f"Nothing in this record excites {', '.join(idle)}; fix {'it' if len(idle) == 1 else 'them'}, or use a "
            "motion that moves at several speeds, both ways; if it does, correct units, gains and sides of the loop."
        )


def projection(Z: FloatArray, J: FloatArray) -> FloatArray:
    """Return ``(Z' J)^-1 Z'``, (parameters, rows), computed with scaled columns.

    A parameter with a zero column has a row of zeros.
    """
    of_Z, of_J = column_norms(Z), column_norms(J)
    scaled = np.linalg.pinv((Z / of_Z).T @ (J / of_J)) @ (Z / of_Z).T
    return np.asarray(scaled / of_J[:, np.newaxis])
