"""How stiff a spring may be and still be reported: the twin, with its spring made stiffer until no record shows it.

Each noisy run ends in a stiffness with an interval, or in a refusal with a bound. What should happen is known
beforehand, from the sensitivities at the truth: they predict how well the stiffness can be known at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from jointid.common.messages import ignore_progress
from jointid.estimation.descent import descend
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.springs import visible
from jointid.estimation.spring_search import frequency_of, on_band
from jointid.paper.twin import Twin, twin
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty

Noise = Literal["disturbance", "white"]

FACTORS = (1.0, 3.0, 10.0, 20.0, 30.0, 50.0, 100.0, 300.0, 1e3, 1e4)
"""Times the K12 of Table 2: free-free modes from 30 Hz to 3 kHz; a log at 1 kHz follows them to 220 Hz."""

PLAIN, INVISIBLE = 0.03, 0.5  # predicted deviations of K12: below, it must be reported; above, it must not
_EXACTLY = 1e-8
_SHARE = 0.33  # of the twin's load in its inertia: bounds are stated for this one


@dataclass(frozen=True, slots=True)
class StiffnessRun:
    """One run: what could be known of its spring, and what was said.

    Attributes:
        stiffness: true.
        predicted: relative standard deviation of the stiffness, from the sensitivities and the noise at the truth.
        value: None where it was refused.
        std: standard deviation of it.
        bound: of a refused one, at the true load share; None where the record bounds nothing.
    """

    stiffness: float
    predicted: float
    value: float | None
    std: float | None
    bound: float | None

    @property
    def holds(self) -> bool:
        """True if 2 sigma about the value hold the stiffness, or it is above the bound."""
        if self.value is None or self.std is None:
            return self.bound is None or self.bound < self.stiffness
        return abs(self.value - self.stiffness) <= 2 * self.std


def judge(seed: int, factor: float, noise: Noise) -> StiffnessRun:
    """Identify one run by a fit that begins at the truth: the search is not tested here."""
    axis = twin("L19", noise=noise, seed=seed, stiffer=factor)
    problem = _problem(axis)
    names = [p.name for p in problem.free]
    at, truth = names.index("stiffness"), problem.vector({**axis.truth, "initial_position": 0.0})
    error, J = problem.linearise(truth)
    predicted = Influence(J, error).robust().std[at] / truth[at]
    end = descend(problem, truth, _EXACTLY)
    x, J = end.x, -end.jacobian
    known = uncertainty(Influence(J, problem.residual(x)), problem.cells(problem.simulate(x)))
    spring = visible(problem, x, J, known, (2, 2), ignore_progress, (_SHARE,))
    value, std = (float(x[at]), float(known.covariance.std[at])) if spring.shown else (None, None)
    bound = spring.bounds[0].stiffness if spring.bounds else None
    return StiffnessRun(float(truth[at]), float(predicted), value, std, bound)


def _problem(axis: Twin) -> ClosedLoopProblem:
    """Return the problem that an identification of a twin ends on: at rest, on a band that follows the mode."""
    record = axis.record.without("motor_position", "load_position")
    problem = torque_problem(record, axis.loop, Filtering(), axis.loop.joint.parameters)
    return on_band(problem.keeping({"initial_velocity": 0.0}), Filtering(), frequency_of(axis.truth))
