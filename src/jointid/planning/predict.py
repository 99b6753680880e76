"""Predicted intervals of a test: noise, maxima and goal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.diagnostics.analysis import rebuild_problem, weights_of
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Record
from jointid.simulation.start import INITIAL
from jointid.uncertainty.covariance import Covariance, Influence

_SAME = 1e-13  # of the largest eigenvalue of the information: what is below is rounding
_PART = 1e-3  # of a direction, that a parameter takes
_PEAKS = 4.0  # deviations of the noise on top of what a test asks for: of 24,000 samples one or two are larger


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Disturbances of a test; all given ones act together.

    Attributes:
        log: standard deviation of white noise on each logged torque, in its unit.
        force: the same of a white force on the motor, held over each period of the controller.
        left: (rows,) filtered residual of the identification of a first record.
        wider: of each parameter, ratio of its reported interval to that by the residual's spectrum.
    """

    log: float = 0.0
    force: float = 0.0
    left: FloatArray | None = None
    wider: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        size = self.log + self.force
        if not (min(self.log, self.force) >= 0 and size < math.inf) or (size == 0.0 and self.left is None):
            raise MethodError(
                "Noise has a positive standard deviation, as without noise every interval is 0; received "
                f"{self.log:g} on the log and {self.force:g} in the loop: give one of them, or a first record."
            )

    @classmethod
    def of(cls, estimate: Estimate, record: Record) -> Noise:
        """Noise from the residual of a record identified completely by DIDIM.

        Raises:
            MethodError: the estimate is not of a simulated loop as declared, or not of this record, or refuses a value.
        """
        rows = [p for p in estimate.rows if p.free]
        wrong = [f"{p.name} free" for p in rows if not p.of_joint and p.name not in INITIAL]
        wrong += [f"no {p.name}" for p in rows if p.value is None or p.stderr is None]
        if estimate.settings.loop is None or wrong:
            raise MethodError(
                "A test is predicted from an estimate by DIDIM under the loop as declared, that gives every parameter; "
                f"this has {', '.join(wrong) or 'no loop'}: give rough values in Python, ji.design(loop, values=...)."
            )
        problem, x = rebuild_problem(estimate, record)
        error, slopes = problem.linearise(x)
        alone = Influence(-slopes, error).stationary().std
        reported = {p.name: p.stderr for p in rows}
        wider = {
            p.name: (reported.get(p.name) or std) / std for p, std in zip(problem.free, map(float, alone), strict=True)
        }
        return cls(left=error, wider=wider)


@dataclass(frozen=True, slots=True, eq=False)
class PredictedTest:
    """The predicted intervals of a test, and its maxima.

    Attributes:
        joint: names of the free parameters, in their order.
        symbols, units, values: of these, by name.
        covariance: of their errors; undetermined parameters have infinite deviations.
        torques: (axes, samples) along the test, without noise.
        sample_time: of the torques, s.
        reached: maxima of the limited quantities of each axis, by name.
    """

    in_json = "std -covariance -reached"
    joint: tuple[str, ...]
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    values: Mapping[str, float]
    covariance: Covariance
    torques: FloatArray
    sample_time: float
    reached: tuple[Mapping[str, float], ...]

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.joint, map(float, self.covariance.std), strict=True))

    def std_of(self, weights: Mapping[str, float]) -> float:
        """Return the standard deviation of a weighted sum of parameters."""
        if not all(math.isfinite(self.std[name]) for name in weights):
            return math.inf
        known = replace(self.covariance, std=np.where(np.isfinite(self.covariance.std), self.covariance.std, 0.0))
        return known.std_of(np.array([weights.get(name, 0.0) for name in self.joint]))


def find_undetermined(J: FloatArray) -> NDArray[np.bool_]:
    """Undetermined parameters, from the near-zero eigenvalues of the scaled ``J' J``."""
    scaled = J / column_norms(J)
    sizes, directions = np.linalg.eigh(scaled.T @ scaled)
    free = directions[:, sizes <= _SAME * max(float(sizes[-1]), 1.0)]
    return np.asarray(np.any(np.abs(free) > _PART, axis=1))


def find_maxima(
    positions: Sequence[FloatArray], velocities: Sequence[FloatArray], acceleration: FloatArray, torque: FloatArray,
    sample_time: float, noise: FloatArray | float, windup: FloatArray | None = None,
) -> tuple[dict[str, float], ...]:  # fmt: skip
    """Return the maxima of the limited quantities of each axis, by name.

    Args:
        positions: (samples, n) each, those of the reference first; the stroke is of all of them.
        velocities: (samples, n) each.
        acceleration: (samples, n) of the reference.
        torque: (samples, n).
        sample_time: of the reference, s.
        noise: (n,) standard deviation of the torque noise.
        windup: (n,) of the springs, nan of a rigid joint.
    """
    low, high = (f([f(one, axis=0) for one in positions], axis=0) for f in (np.min, np.max))
    each = {
        "lower": np.min(positions[0], axis=0),
        "upper": np.max(positions[0], axis=0),
        "stroke": high - low,
        "speed": np.max([np.max(np.abs(one), axis=0) for one in velocities], axis=0),
        "acceleration": np.max(np.abs(acceleration), axis=0, initial=0.0),
        "jerk": np.max(np.abs(np.diff(acceleration, axis=0)), axis=0, initial=0.0) / sample_time,
        "torque": np.max(np.abs(torque), axis=0) + _PEAKS * noise,
        "rms_torque": np.sqrt(np.mean(torque**2, axis=0) + np.square(noise)),
        "windup": np.full(torque.shape[1], np.nan) if windup is None else windup,
    }
    rows = ({name: float(sizes[k]) for name, sizes in each.items()} for k in range(torque.shape[1]))
    return tuple({name: size for name, size in row.items() if not math.isnan(size)} for row in rows)


ALL = "all"
"""The goal beside those that name a quantity: the volume of the intervals (D-optimal)."""

_TINY = 1e-30
_ZERO = 1e-9  # of a value: what is less is rounding, and no scale


@dataclass(frozen=True, slots=True)
class Goal:
    """Goal of a test.

    Attributes:
        weights: of the goal's parameters, by name; empty for all parameters.
    """

    name: str
    weights: Mapping[str, float]

    def score(self, test: PredictedTest) -> float:
        """Logarithmic objective of a test; lower is better, differences are relative.

        If the goal is all parameters, deviations are scaled by the values, and offsets do not count beside others.
        """
        covariance, names, values = test.covariance, test.joint, test.values
        own = [i for i, name in enumerate(names) if (name in self.weights if self.weights else "offset" not in name)]
        own = own or [*range(len(names))]
        if not np.all(np.isfinite(covariance.std[own])):
            return math.inf
        std = covariance.std[own]
        matrix = np.outer(std, std) * covariance.correlation[np.ix_(own, own)]
        if self.weights:
            w = np.array([self.weights[names[i]] for i in own])
            return 0.5 * math.log(max(float(w @ matrix @ w), _TINY))
        size = np.array([abs(values[names[i]]) if abs(values[names[i]]) > _ZERO else 1.0 for i in own])
        found = np.maximum(np.linalg.eigvalsh(matrix / np.outer(size, size)), _TINY)
        return 0.5 * float(np.mean(np.log(found)))


def parse_goal(name: str, units: Mapping[str, str]) -> Goal:
    """Parse a goal, a combination of parameters or "all"; `units` by name."""
    if name == ALL:
        return Goal(name, {})
    weights = weights_of(name)
    unknown = [one for one in weights if one not in units]
    if unknown:
        raise MethodError(
            f'The goal "{name}" names {", ".join(unknown)}, which is no free parameter here; choose from '
            f'{", ".join(units)}, a sum or a difference of them, or "{ALL}".'
        )
    several = sorted({units[one] for one in weights})
    if len(several) > 1:
        raise MethodError(f'The goal "{name}" adds {" and ".join(several)}; only what has one unit can be added.')
    return Goal(name, weights)
