"""The share of the torque that is no linear response to the reference and its direction: what no loop would explain.

A linear loop answers its reference linearly, and Coulomb friction is one more input of it, the sign of the velocity.
So the torque is fitted by free responses, as long as a loop remembers, to the reference's acceleration, its velocity
and its direction, and to what is known to be injected. No controller and no joint are assumed, and what is left is
about what the right ones would leave: a cause that leaves clearly more is not all that is wrong.
"""

from __future__ import annotations

import math

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import INJECTED
from jointid.simulation.loop_input import to_log

MEMORY = 0.3
"""Seconds that a loop remembers."""
SHORTEST = 2.0
"""Seconds of a record: a shorter one, less its borders, has fewer than two samples for each number of the responses."""
_STANDS = 1e-9  # of the greatest velocity
_RIDGE = 1e-10  # of a column's square: responses between samples of a filtered signal are nearly the same


def find_unexplained_share(problem: ClosedLoopProblem, reference: FloatArray, memory: float = MEMORY) -> float:
    """Return what free linear responses to a reference, and to what is injected, leave of the torque, a share of it.

    Args:
        problem: whose torque and filter are used.
        reference: (samples,) in m or rad, over the same time.
        memory: s; how long the responses are.
    """
    torque = problem.filtered(problem.measured)
    if reference.size != problem.measured.size:  # logged at a rate of its own
        at = np.arange(problem.measured.size) * (reference.size / problem.measured.size)
        reference = np.interp(at, np.arange(reference.size), reference)
    velocity = np.gradient(reference)
    moving = np.abs(velocity) > _STANDS * np.max(np.abs(velocity))
    inputs = [np.gradient(velocity), velocity, np.sign(np.where(moving, velocity, 0.0))]
    if problem.experiment.injected:
        experiment = problem.experiment
        inputs.append(to_log(experiment, experiment.inputs[:, INJECTED] + experiment.after_limit))
    count, seen = len(inputs), problem.filtered(np.column_stack(inputs))
    lags = min(math.ceil(memory / (problem.sample_time * reference.size / torque.size)), torque.size)
    rows, width = torque.size, count * lags + 1
    if rows < 2 * width:
        return 0.0
    products = np.empty((width, width))
    projected = np.empty(width)
    blocks = [slice(k * lags, (k + 1) * lags) for k in range(count)]
    for one, here in zip(seen.T, blocks, strict=True):
        for other, there in zip(seen.T, blocks, strict=True):
            products[here, there] = _multiply_later(one, other, lags)
        products[here, -1] = products[-1, here] = np.cumsum(one)[rows - lags :][::-1]
        projected[here] = [torque[late:] @ one[: rows - late] for late in range(lags)]
    products[-1, -1], projected[-1] = rows, np.sum(torque)
    sizes = np.sqrt(np.diag(products))
    sizes[sizes == 0.0] = 1.0
    products, projected = products / np.outer(sizes, sizes), projected / sizes
    weights = np.linalg.solve(products + _RIDGE * np.eye(width), projected)
    square = float(torque @ torque)
    left = max(square - 2 * float(weights @ projected) + float(weights @ products @ weights), 0.0)
    return math.sqrt(left / square) * math.sqrt(rows / (rows - width))


def _multiply_later(one: FloatArray, other: FloatArray, lags: int) -> FloatArray:
    """Return the products, (lags, lags), of two signals, each later by 0, 1, ... samples and zero before.

    One sample later, both have lost their last one: that is the next diagonal entry, so no column is written out.
    """
    rows = one.size
    found = np.empty((lags, lags))
    found[0] = [one[late:] @ other[: rows - late] for late in range(lags)]
    found[:, 0] = [other[late:] @ one[: rows - late] for late in range(lags)]
    last, others = one[::-1], other[::-1]
    for late in range(lags - 1):
        found[late + 1, 1:] = found[late, :-1] - last[late] * others[: lags - 1]
    return found
