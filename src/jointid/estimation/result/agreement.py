"""Do records agree? The estimates of each by itself, tested against one common value.

With the estimates x_k of K records and their covariances V_k, the common value is their generalised least squares, and
what each differs from it, weighed by its own covariance, is chi-square where they agree (Wald; Cochran 1954)::

    Q = sum_k (x_k - x)' V_k^-1 (x_k - x)        of (K - 1) p degrees of freedom

jointly over p parameters, and of K - 1 for each by itself. Where all of them jointly differ so much by a chance of less
than 5 %, those that do by themselves disagree (Fisher's protected comparisons); and so does, whatever the others say, a
parameter with less than 5 % over p (Bonferroni). Of records that agree, one in ten at most is then called otherwise.
What the runs differ by is no noise within a run, and the variance between runs is that of DerSimonian and Laird
(1986)::

    t^2 = max(0, (Q - (K - 1)) / (sum w - sum w^2 / sum w)),        w = 1 / V_k

It widens the deviation of the common value by ``t^2 sum w^2 / (sum w)^2``. From two records it is one number squared:
as uncertain as its own size. The records' errors are taken to be independent; what repeats in both of them alike (the
same friction at the same place) makes them agree too well, and is no business of this test.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.uncertainty.covariance import Covariance

_LEVEL = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Alone:
    """What one record says by itself.

    Attributes:
        values: of the parameters that records may share, by name.
        covariance: of their errors, in the same order.
    """

    values: Mapping[str, float]
    covariance: Covariance

    def chosen(self, names: Sequence[str]) -> tuple[FloatArray, FloatArray]:
        """Return values and covariances of some of them, (names,) and (names, names)."""
        at = [list(self.values).index(name) for name in names]
        return np.array([self.values[name] for name in names]), self.covariance.matrix[np.ix_(at, at)]


@dataclass(frozen=True, slots=True)
class Scatter:
    """How one parameter differs between records.

    Attributes:
        name, unit: of the parameter.
        records: that were compared.
        statistic: Q, of ``records - 1`` degrees of freedom.
        p_value: how often records that agree differ so much.
        between: standard deviation between the runs, 0 where their own intervals explain the difference.
        differs: whether it disagrees, allowing for how many parameters were tested.
        share: of the between-run variance that is in the common value: ``sum w^2 / (sum w)^2``.
    """

    name: str
    unit: str
    records: int
    statistic: float
    p_value: float
    between: float
    differs: bool
    share: float

    @property
    def widening(self) -> float:
        """The variance that is to be added to that of the common value; 0 where the records agree."""
        return self.between**2 * self.share if self.differs else 0.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """Whether records agree.

    Attributes:
        parameters: one by one.
        statistic, degrees, p_value: of all of them jointly; the last is None where nothing was compared.
    """

    parameters: tuple[Scatter, ...]
    statistic: float
    degrees: int
    p_value: float | None

    @property
    def differs(self) -> bool:
        """Whether the records differ by more than their intervals allow, jointly or in one of the parameters."""
        return any(p.differs for p in self.parameters) or (self.p_value is not None and self.p_value <= _LEVEL)

    def __getitem__(self, name: str) -> Scatter:
        """Return how a parameter differs, by its name."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def __str__(self) -> str:
        """Return the verdict in a sentence."""
        if self.p_value is None:
            return "no parameter is shared by records that could each tell it alone, so nothing says whether they agree"
        records = max(p.records for p in self.parameters)
        tested = f"chi-square {number(self.statistic, 3)} of {self.degrees}, p = {self.p_value:.2g}"
        off = [p for p in self.parameters if p.differs]
        few = "; two runs give it one degree of freedom, so it is a rough number" if records == 2 else ""
        if off:
            listed = ", ".join(f"{p.name} {number(p.between, 2)} {p.unit} (p = {p.p_value:.2g})" for p in off)
            return (
                f"the {records} records disagree by more than their intervals allow ({tested}); standard deviation "
                f"between runs: {listed}{few}; the interval of the common value is widened by it"
            )
        if self.differs:
            return (
                f"the {records} records disagree jointly by more than their intervals allow ({tested}), though no "
                "parameter does by itself: what they share is not the same in all of them"
            )
        return f"the {records} records agree within their intervals ({tested})"


def agreement(records: Sequence[Alone], units: Mapping[str, str]) -> Agreement:
    """Return whether records agree in the parameters that two or more of them have.

    Args:
        records: what each says by itself; a parameter that one could not tell is left out of it.
        units: of the parameters, by name; those that are compared.
    """
    shared = [name for name in units if sum(name in r.values for r in records) > 1]
    if not shared:
        return Agreement((), 0.0, 0, None)
    statistic, degrees = _jointly(records, shared)
    p_value = _beyond(statistic, degrees)
    level = _LEVEL if p_value <= _LEVEL else _LEVEL / len(shared)
    found = tuple(_one(name, units[name], records, level) for name in shared)
    return Agreement(found, statistic, degrees, p_value)


def _one(name: str, unit: str, records: Sequence[Alone], level: float) -> Scatter:
    """Return how one parameter differs; it does where chance does as much with less than the level."""
    pairs = [r.chosen([name]) for r in records if name in r.values]
    values = np.array([value[0] for value, _ in pairs])
    weights = 1.0 / np.array([variance[0, 0] for _, variance in pairs])
    total, squares = float(weights.sum()), float(weights @ weights)
    statistic = float(weights @ (values - weights @ values / total) ** 2)
    degrees = values.size - 1
    apart = (
        2.0 * float(np.sum(np.triu(np.outer(weights, weights), 1))) / total
    )  # sum w - sum w^2 / sum w, to all digits
    between = math.sqrt(max(statistic - degrees, 0.0) / apart)
    p_value = _beyond(statistic, degrees)
    return Scatter(name, unit, values.size, statistic, p_value, between, p_value <= level, squares / total**2)


def _jointly(records: Sequence[Alone], names: Sequence[str]) -> tuple[float, int]:
    """Return Q over several parameters, and its degrees of freedom."""
    rows, sought = [], []
    for record in records:
        own = [name for name in names if name in record.values]
        if not own:
            continue
        values, covariance = record.chosen(own)
        std = np.sqrt(np.diag(covariance))
        sizes, directions = np.linalg.eigh(covariance / np.outer(std, std))
        whiten = (directions / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1]))).T / std
        columns = np.zeros((len(own), len(names)))
        columns[range(len(own)), [names.index(name) for name in own]] = 1.0
        rows.append(whiten @ columns)
        sought.append(whiten @ values)
    A, b = np.vstack(rows), np.concatenate(sought)
    scale = np.linalg.norm(A, axis=0)
    left = b - A / scale @ np.linalg.lstsq(A / scale, b, rcond=None)[0]
    return float(left @ left), b.size - len(names)


def _beyond(statistic: float, degrees: int) -> float:
    """Return how often a chi-square of so many degrees of freedom is larger."""
    from scipy.special import chdtrc

    return float(chdtrc(degrees, statistic))
