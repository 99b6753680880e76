"""Laws, run: from reference and position to torque, and back from torque to position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.controllers.sampled import LIMIT, POSITION, SampledLaw


@dataclass(frozen=True, slots=True, eq=False)
class LawRun:
    """A run of a law, period by period.

    Attributes:
        raw: (periods, elements) before limits and gates. excess: (periods, elements) what these took away or added.
        output: (periods,) the torque that acts. tapped: (periods,) the one behind the torque's limit.
    """

    raw: FloatArray
    excess: FloatArray
    output: FloatArray
    tapped: FloatArray


def run(law: SampledLaw, inputs: FloatArray, state: FloatArray) -> LawRun:
    """Run the law on these inputs, within its limits.

    Args:
        law: the law.
        inputs: (periods, INPUTS), once per period.
        state: (states,) at the first period (see `SampledLaw.memory`).
    """
    excess = np.zeros((len(inputs), law.limits.size))
    raw = _respond(law, inputs, state, excess, True)
    values = raw + excess
    return LawRun(raw, excess, values[:, law.output], values[:, law.tap])


def respond(law: SampledLaw, inputs: FloatArray, state: FloatArray, excess: FloatArray | None = None) -> FloatArray:
    """Return the linear answer of all elements, before limits and gates, (periods, elements).

    Args:
        law: the law.
        inputs: (periods, INPUTS); leave a column 0 to get the answer to the others alone.
        state: (states,) at the first period.
        excess: (periods, elements) what limits and gates do; nothing when None.
    """
    given = np.zeros((len(inputs), law.limits.size)) if excess is None else np.ascontiguousarray(excess)
    return _respond(law, inputs, state, given, False)


def _respond(law: SampledLaw, inputs: FloatArray, state: FloatArray, excess: FloatArray, free: bool) -> FloatArray:
    from jointid.common.iir_kernels import respond as recur

    starts, sources, weights = _rows(law)
    raw = np.empty((len(inputs), law.limits.size))
    recur(
        starts, sources, weights, law.limits, law.gates, free, state.copy(), np.ascontiguousarray(inputs), excess, raw
    )
    return raw


def _rows(law: SampledLaw) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return the law's weights that are not 0, as `recurrences.respond` reads them."""
    whole = np.concatenate(
        [np.concatenate([law.C, law.D, law.E], axis=2), np.concatenate([law.A, law.B, law.F], axis=2)], axis=1
    )
    phases, rows, sources = np.nonzero(whole)
    counts = np.zeros(whole.shape[:2], dtype=np.int64)
    np.add.at(counts, (phases, rows), 1)
    ends = np.cumsum(counts).reshape(counts.shape)
    starts = np.concatenate([ends[:, :1] - counts[:, :1], ends], axis=1)
    return starts, sources.astype(np.int64), whole[phases, rows, sources]


def invert(
    law: SampledLaw, torque: FloatArray, inputs: FloatArray, state: FloatArray, element: int | None = None
) -> FloatArray:
    """Return the motor position that makes the law put out `torque`, shape (periods,).

    ``position = reference - C^-1(torque)``: exact where the torque, and nothing before it, was at a limit. It turns
    noise dT of the torque into dT / |D| of position within the period, and dT over the law's static gain slowly: for
    most loops far below an encoder's step.

    Args:
        law: the law; its direct gain from position must not be 0.
        torque: (periods,) an element's value, before the law's delay, at its period.
        inputs: (periods, INPUTS) as for `run`; the position column is not read.
        state: (states,) at the first period.
        element: whose value the torque is; the one behind the torque's limit when None.

    Raises:
        MethodError: the law has no direct gain from position, or its inverse is unstable.
    """
    element = law.tap if element is None else element
    gain = law.D[:, element, POSITION]
    if np.any(gain == 0.0):
        raise MethodError(
            "This law does not react to the position within its period, so it cannot be inverted; "
            'choose start = "regular".'
        )
    back, out = law.B[:, :, POSITION] / gain[:, np.newaxis], law.C[:, element]
    direct = law.D[:, element]
    A = law.A - back[:, :, np.newaxis] * out[:, np.newaxis]
    whole = np.eye(law.order)
    for step in A:
        whole = step @ whole
    if law.order and np.max(np.abs(np.linalg.eigvals(whole))) >= 1.0 + 1e-9:
        raise MethodError('The inverse of this law is unstable, so it gives no start; choose start = "regular".')
    B = law.B - back[:, :, np.newaxis] * direct[:, np.newaxis]
    D = -direct / gain[:, np.newaxis]
    # The torque takes the place of the position among the inputs.
    B[:, :, POSITION], D[:, POSITION] = back, 1.0 / gain
    none = np.zeros((law.phases, 1, 1))
    turned = SampledLaw(
        A, B, -out[:, np.newaxis] / gain[:, np.newaxis, np.newaxis], D[:, np.newaxis], none,
        np.zeros((law.phases, law.order, 1)), np.array([np.inf]), np.array([LIMIT]), np.array([True]), 0, 0, law.period,
    )  # fmt: skip
    columns = inputs.copy()
    columns[:, POSITION] = torque
    return respond(turned, columns, state)[:, 0]
