"""Part of the time in which a residual is concentrated.

A contact, a hand on the arm or a drive that is off acts for a part of the record. No number of the joint, the loop or
the log explains it, and each that is fitted to it is wrong. The squares of the residual are summed over blocks of time,
and each run of blocks is compared with the rest. A run is a finding where its mean square is more than 25 times that
of the rest, and where the same blocks in random order seldom have a run that exceeds the rest by as much. A run at the
beginning of the record is none: a wrong model of the first motion is seen there.

Noise, an unmodelled spring and friction follow the motion, which comes back: on healthy drives the largest ratio is
about 3, and with a known fault that was not taken off wholly 20.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.messages import Message
from jointid.common.text import number
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason

_BLOCKS = 40  # of a residual
_FEWEST = 4  # rows of a block
_SHORTEST = 2  # blocks of a part
_TIMES = 25.0  # as much as elsewhere
_ORDERS = 199  # of the blocks, at random
_LEVEL = 0.1


@dataclass(frozen=True, slots=True)
class Part:
    """Part of the time in which a residual is concentrated.

    Attributes:
        begin, end: of it, s.
        share: of the squares of the residual that are in it.
    """

    begin: float
    end: float
    share: float

    @property
    def reason(self) -> Message:
        """The message that states it."""
        clause = f"from {number(self.begin, 3)} to {number(self.end, 3)} s the torque does not follow the model"
        words = (
            f"{clause}: {number(100 * self.share, 2)} % of the squares of the residual are there, and no known fault "
            "explains them, as where something touches the joint; leave that out by record.start and record.stop "
            "(times count from the first sample that was read)"
        )
        values = {"begin": self.begin, "end": self.end, "share": self.share}
        return Message(Reason.MISFIT_IN_PART, words, values, clause)


def find_part(residual: FloatArray, time: FloatArray) -> Part | None:
    """Return the part of the time in which a residual is concentrated, or None.

    Args:
        residual: (rows,) in the order of time.
        time: (rows,) of them, s.
    """
    size = residual.size // _BLOCKS
    if size < _FEWEST or not np.any(residual):
        return None
    squares = np.sum(residual[: size * _BLOCKS].reshape(_BLOCKS, size) ** 2, axis=1)
    begin, end = np.triu_indices(_BLOCKS + 1, _SHORTEST)
    inside = (end - begin <= _BLOCKS // 2) & (begin > 1)
    begin, end = begin[inside], end[inside]
    count = end - begin

    def exceed(blocks: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return by how much each run exceeds the rest, by the deviation of its sum, and the sums."""
        ends = np.concatenate([[0.0], np.cumsum(blocks)])
        within = ends[end] - ends[begin]
        rest = (ends[-1] - within) / (_BLOCKS - count)
        return (within - count * rest) / np.sqrt(count), within

    strength, within = exceed(squares)
    best = int(np.argmax(strength))
    whole = float(np.sum(squares))
    if within[best] / count[best] < _TIMES * (whole - within[best]) / (_BLOCKS - count[best]):
        return None
    random = np.random.default_rng(0)
    by_chance = sum(np.max(exceed(random.permutation(squares))[0]) >= strength[best] for _ in range(_ORDERS))
    if (1 + by_chance) / (1 + _ORDERS) > _LEVEL:
        return None
    return Part(float(time[begin[best] * size]), float(time[end[best] * size - 1]), float(within[best]) / whole)


def find_part_of_loop(problem: ClosedLoopProblem, x: FloatArray) -> Part | None:
    """Return the part of the time in which a joint does not follow its solved problem, or None."""
    residual = problem.residual(x)
    return find_part(residual, np.linspace(0.0, problem.measured.size * problem.sample_time, residual.size))
