"""Does the joint stay what it is? Each stretch of a long record by itself, and whether they agree.

A stretch is a number of windows that follow each other. What it says alone is one Gauss-Newton step from what all of
them say, which is near; its deviations come from leaving out one of its windows after the other. That the stretches
agree is tested as for records of their own (`together.scatter`), and a straight line through them tells how fast what
they say changes: a gear that warms up, a bearing that runs dry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.data.record import FloatArray
from jointid.inference.groups import left_out, step_of, total
from jointid.inference.uncertainty import Covariance
from jointid.long.window import Window
from jointid.model.parameters import Parameter
from jointid.together.scatter import Agreement, Alone, agreement

_MOST = 24  # stretches
_WINDOWS = 5  # in a stretch at least, for each parameter: from fewer their scatter is too rough to test by
_HOUR = 3600.0


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """What a part of a long record says by itself.

    Attributes:
        begin, end: seconds from the first sample of the record.
        windows: in it.
        values: of the free parameters, by name; std: their standard deviations.
        filtered_error: what the joint of the whole record leaves of its filtered torque; a ratio.
    """

    begin: float
    end: float
    windows: int
    values: Mapping[str, float]
    std: Mapping[str, float]
    filtered_error: float


@dataclass(frozen=True, slots=True)
class Trend:
    """The straight line through what the stretches say of a parameter.

    Attributes:
        name: of the parameter. per_hour: its change, in its unit. std: of that.
    """

    name: str
    per_hour: float
    std: float


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """Whether a long record tells one joint from beginning to end.

    Attributes:
        stretches: in the order of time; none where the record is too short for two.
        agreement: whether they agree; None without them.
        trends: of the parameters, in their order.
    """

    stretches: tuple[Stretch, ...]
    agreement: Agreement | None
    trends: tuple[Trend, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters that change by more than their intervals allow."""
        return () if self.agreement is None else tuple(p.name for p in self.agreement.parameters if p.differs)


def drift(windows: Sequence[Window], x: FloatArray, free: Sequence[Parameter], units: Mapping[str, str]) -> Drift:
    """Return what the stretches of a record say, and whether they agree.

    Args:
        windows: in the order of time, at x.
        x: (free,) what all of them say.
        free: the parameters.
        units: of the parameters, by name.
    """
    count = min(_MOST, len(windows) // (_WINDOWS * len(free)))
    if count < 2:
        return Drift((), None, ())
    names = [p.name for p in free]
    stretches, alone = [], []
    for part in np.array_split(np.arange(len(windows)), count):
        chosen = [windows[i] for i in part]
        value, covariance = _alone(chosen, x)
        sums = total([w.sums for w in chosen])
        values = dict(zip(names, map(float, value), strict=True))
        std = dict(zip(names, map(float, covariance.std), strict=True))
        error = math.sqrt(sums.square / sums.size) if sums.size > 0 else 0.0
        stretches.append(Stretch(chosen[0].begin, chosen[-1].end, len(chosen), values, std, error))
        alone.append(Alone(values, covariance))
    judged = agreement(alone, {name: units[name] for name in names})
    return Drift(tuple(stretches), judged, tuple(_trend(name, stretches) for name in names))


def _alone(windows: Sequence[Window], x: FloatArray) -> tuple[FloatArray, Covariance]:
    """Return what some windows say, and how sure that is."""
    anywhere = np.full(x.size, np.inf)
    step = step_of(total([w.sums for w in windows]), -anywhere, anywhere)
    return x + step, left_out([w.sums.moved(step) for w in windows])


def _trend(name: str, stretches: Sequence[Stretch]) -> Trend:
    """Return the weighted least-squares line through the stretches."""
    hours = np.array([0.5 * (s.begin + s.end) for s in stretches]) / _HOUR
    values, std = np.array([s.values[name] for s in stretches]), np.array([s.std[name] for s in stretches])
    weights = 1.0 / np.maximum(std, np.finfo(float).tiny) ** 2
    centred = hours - weights @ hours / weights.sum()
    power = float(weights @ centred**2)
    return Trend(name, float(weights @ (centred * values)) / power, 1.0 / math.sqrt(power))
