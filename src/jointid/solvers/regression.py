"""Linear least squares by QR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
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


def conditioning(W: FloatArray, values: FloatArray) -> Conditioning:
    """Return the condition numbers of a regressor, (rows, parameters), at estimates, (parameters,)."""
    norms = np.linalg.norm(W, axis=0)
    R, scale = np.asarray(np.linalg.qr(W / norms, mode="r")), np.where(values == 0.0, 1.0, np.abs(values))
    return Conditioning(*(float(np.linalg.cond(R * by)) for by in (norms, 1.0, norms * scale)))


def least_squares(W: FloatArray, Y: FloatArray, names: tuple[str, ...]) -> FloatArray:
    """Solve ``Y = W x`` by QR with column scaling; return x, (parameters,).

    Args:
        W: (rows, parameters).
        Y: (rows,).
        names: of the parameters, for the error.

    Raises:
        MethodError: the rows are too few, or do not determine the parameters.
    """
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
    return np.asarray(np.linalg.solve(R, Q.T @ Y) / norms)


def refuse_idle(columns: FloatArray, names: tuple[str, ...]) -> None:
    """Refuse columns (rows, parameters) of zeros; the sentence names the parameters."""
    norms = np.linalg.norm(columns, axis=0)
    idle = [name for name, norm in zip(names, norms, strict=True) if not norm > 0]
    if idle:
        raise MethodError(
            f"Nothing in this record excites {', '.join(idle)}; fix {'it' if len(idle) == 1 else 'them'}, or use a "
            "motion that moves at several speeds, both ways; if it does, correct units, gains and sides of the loop."
        )
