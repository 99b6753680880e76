"""DIDIM for flexible joints: the criterion (9) minimised over all the parameters of (2), from torque and reference.

The load is not controlled, so the regressor on the simulated motion is no approximation of the Jacobian [P section
IV.B]; what is left is the criterion itself, ``J = ||Y - Ys||^2`` of the filtered, decimated torque. Two ways down:

- least squares with the output sensitivities, by SciPy's bounded trust region;
- Nelder-Mead by the rules of MATLAB's ``fminsearch``, as the paper did, restarted because it stops early.

Both begin as the paper does, with a rigid identification at low frequency. Its values are divided between the sides,
by halves in the paper (13), and the stiffness follows from a known or guessed frequency: ``K12 = mu (2 pi f)^2`` with
``mu = ZZ1 ZZ2 / (ZZ1 + ZZ2)``. Where the frequency is not known, a grid of frequencies and load shares is simulated,
and the best few are refined: half of such a grid is unstable for a fast loop, and the rest has local minima.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.data.record import FloatArray, Record
from jointid.data.signals import Filtering
from jointid.estimation.descent import Descent, by_least_squares, by_simplex, refined
from jointid.estimation.didim import DIDIM, answer, identify_didim
from jointid.estimation.estimate import Estimate
from jointid.estimation.problem import Problem, initial_of, torque_problem
from jointid.estimation.starts import pseudo_regular
from jointid.estimation.surroundings import INITIAL_STATE
from jointid.estimation.uncertainty import Covariance, sandwich, words
from jointid.model.joints import FlexibleJoint, RigidJoint
from jointid.model.parameters import Parameter
from jointid.simulation.closed_loop import in_threads, simulate
from jointid.simulation.experiment import ClosedLoop

_RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz
_GUESSES = (0.2, 0.27, 0.35, 0.45, 0.55, 0.7, 0.9)  # frequencies to try, as shares of the cut-off
_SHARES = (0.5, 0.2, 0.33, 0.67)  # of the load in the inertia, to try: first the halves of (13)
_REFINED = 4  # starts of a grid that are refined
_TOLERANCE, _SIMPLEX_TOLERANCE = 1e-8, 1e-4  # the latter is that of fminsearch
_NOTHING = 0.5  # of the torque: an end that leaves so much is no answer
_MOVING = 9.0  # times the residual's variance: what a velocity at the first sample must explain to be believed


@dataclass(frozen=True, slots=True)
class FlexibleDIDIM:
    """Settings of DIDIM for a flexible joint.

    Attributes:
        minimiser: "least-squares", or the paper's "nelder-mead".
        frequency: free-free frequency in Hz the stiffness starts from; several load shares are tried with it, and
            for Nelder-Mead the inertia is halved as in (13) unless that loop is unstable. None tries a grid of both,
            a simulation each.
        rigid_cutoff: Hz, of the rigid identification that gives the start; 0.5 % of the sampling frequency when None.
        tolerance: relative, on the parameters and the criterion; when None 1e-8, and 1e-4 for Nelder-Mead.
        simulations: at most, of one descent.
        restarts: of Nelder-Mead, each from where the last one stopped; it ends when one gains nothing.
        statistics: "sensitivities" for the deviations of the output sensitivities, or the paper's "inverse-model".
    """

    minimiser: Literal["least-squares", "nelder-mead"] = "least-squares"
    frequency: float | None = None
    rigid_cutoff: float | None = None
    tolerance: float | None = None
    simulations: int = 6000
    restarts: int = 3
    statistics: Literal["sensitivities", "inverse-model"] = "sensitivities"

    def __post_init__(self) -> None:
        choices = {
            "minimiser": (self.minimiser, ("least-squares", "nelder-mead")),
            "statistics": (self.statistics, ("sensitivities", "inverse-model")),
        }
        for name, (value, allowed) in choices.items():
            if value not in allowed:
                raise MethodError(f'The {name} is one of {", ".join(allowed)}; received "{value}".')
        positive = (self.frequency or 1.0, self.rigid_cutoff or 1.0, self.tolerance or 1.0, float(self.simulations))
        if min(positive) <= 0 or self.tolerance == 0 or self.restarts < 0:
            raise MethodError(
                "Frequencies, tolerance and simulations are positive, restarts 0 or more; received "
                f"{self.frequency}, {self.rigid_cutoff}, {self.tolerance}, {self.simulations} and {self.restarts}."
            )

    @classmethod
    def paper(cls, frequency: float | None = 30.0) -> FlexibleDIDIM:
        """Return the settings of the paper: Nelder-Mead with the tolerance of ``fminsearch``, its statistics.

        The frequency is the 30 Hz the paper measured with its output blocked.
        """
        return cls("nelder-mead", frequency, None, 1e-4, 6000, 1, "inverse-model")


def stopping_tolerance(settings: FlexibleDIDIM) -> float:
    """Return the tolerance that settings stop at: their own, or their minimiser's."""
    return settings.tolerance or (_TOLERANCE if settings.minimiser == "least-squares" else _SIMPLEX_TOLERANCE)


def identify_flexible(
    record: Record,
    loop: ClosedLoop,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    settings: FlexibleDIDIM | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Identify a flexible joint from torque and reference.

    Args:
        record: with the torque and what the controller reads.
        loop: flexible joint and controller.
        parameters: of the joint; a start of its own replaces that of the method.
        filtering: cut-off and decimation; the mode must lie below the cut-off.
        settings: see `FlexibleDIDIM`.
        progress: is told the iterations.

    Raises:
        RecordError: a channel is missing.
        MethodError: the loop cannot be simulated at any start.
    """
    settings = settings or FlexibleDIDIM()
    rigid = _rigid(record, loop, settings, progress)
    problem = torque_problem(record, loop, filtering, parameters, _at_rest(record, settings))
    descent = Descent(problem, progress)
    x, stop, converged = _descended(descent, _starts(descent, rigid, settings), settings)
    if rigid["initial_velocity"].free:  # below its resonance the axis seemed to move at the first sample
        x, stop, converged = _or_moving(descent, x, rigid, settings, (stop, converged))
    problem = descent.problem
    error = descent.residual(x)
    covariance, intervals = _covariance(descent, x, error, settings)
    values = problem.values(x)
    run = simulate(loop, problem.experiment, values, initial_of(values))
    descent.simulations += 1
    if np.linalg.norm(error) > _NOTHING * descent.size:
        stop, converged = f"no answer: the search ended where the model explains little of the torque ({stop})", False
    estimate = answer(record, problem, x, run, error, covariance, stop, converged)
    how = "Nelder-Mead" if settings.minimiser == "nelder-mead" else "least squares"
    unsure = _unsure(estimate)
    found = tuple(replace(p, identifiable=p.identifiable and p.name not in unsure) for p in estimate.parameters)
    lost = tuple(f"{name} is not identifiable from this record: its interval holds 0" for name in unsure)
    return replace(
        estimate,
        parameters=found,
        warnings=(*lost, *_touched(problem, x, descent.scales), *estimate.warnings),
        variant=f"DIDIM by {how} from the pseudo-regular start",
        intervals=intervals,
        trace=tuple(descent.trace),
        simulations=descent.simulations + rigid.simulations,
    )


def _unsure(estimate: Estimate) -> tuple[str, ...]:
    """Return the names of the inertias and the stiffness that the record does not tell from 0."""
    physical = ("motor_inertia", "load_inertia", "stiffness")
    return tuple(n for n in physical if estimate[n].free and estimate.values[n] <= 2 * (estimate[n].std or 0.0))


def _touched(problem: Problem, x: FloatArray, scales: FloatArray) -> tuple[str, ...]:
    """Return a warning for each parameter that a bound holds."""
    near = 1e-6 * scales
    at = [
        p
        for p, value, gap in zip(problem.free, x, near, strict=True)
        if value <= p.lower + gap or value >= p.upper - gap
    ]
    return tuple(f"{p.name} is at its bound, where it does not follow the record" for p in at)


def _descended(descent: Descent, starts: list[FloatArray], settings: FlexibleDIDIM) -> tuple[FloatArray, str, bool]:
    """Go down from the starts, best first; return where that ends, why, and whether it is a good end."""
    tolerance = stopping_tolerance(settings)
    if settings.minimiser == "nelder-mead":
        return by_simplex(descent, starts[0], tolerance, settings.simulations, settings.restarts)
    return by_least_squares(descent, starts, tolerance)


def _rigid(record: Record, loop: ClosedLoop, settings: FlexibleDIDIM, progress: Progress) -> Estimate:
    """Identify the joint as rigid, below its resonance."""
    assert isinstance(loop.joint, FlexibleJoint)
    joint = RigidJoint(loop.joint.kind, loop.joint.friction, loop.joint.torque_unit)
    record.require(loop.channels, "DIDIM")
    assert record.torque is not None
    cutoff = settings.rigid_cutoff or _RIGID_CUTOFF / record.torque.sample_time
    progress(f"identifying the joint as rigid, below {cutoff:g} Hz")
    rigid = ClosedLoop(joint, loop.controller)
    return identify_didim(record, rigid, joint.parameters, Filtering(cutoff=cutoff), DIDIM(), progress)


def _at_rest(record: Record, settings: FlexibleDIDIM) -> tuple[Parameter, ...]:
    """Return the initial state at rest: on the reference for Nelder-Mead, which should search no more than it must.

    Where a rigid model of a flexible joint puts the motor is no guide: it is off by more than its deviations say.
    """
    assert record.reference is not None
    position, velocity = INITIAL_STATE
    home = float(record.reference.values[0])
    known = position.fixed(home) if settings.minimiser == "nelder-mead" else replace(position, start=home)
    return known, velocity.fixed(0.0)


def _or_moving(
    descent: Descent, x: FloatArray, rigid: Estimate, settings: FlexibleDIDIM, end: tuple[str, bool]
) -> tuple[FloatArray, str, bool]:
    """Return the better of two answers, the motor at rest at the first sample or moving: see `didim`."""
    resting, scales = descent.problem, descent.scales
    error = descent.residual(x)
    free = settings.minimiser == "least-squares"
    values = resting.values(x) | {p.name: rigid[p.name].value or 0.0 for p in INITIAL_STATE}
    state = tuple(replace(p, start=values[p.name], free=free) for p in INITIAL_STATE)
    descent.problem = replace(resting, parameters=(*resting.parameters[: -len(INITIAL_STATE)], *state))
    if free:  # two more to search, each on its own size
        descent.scales = np.append(scales[: len(resting.free_joint)], _scales(descent.problem.vector(values)[-2:]))
    moving, stop, converged = _descended(descent, [descent.problem.vector(values)], settings)
    gained = float(error @ error) - float(np.sum(descent.residual(moving) ** 2))
    if gained > _MOVING * float(error @ error) / error.size:
        return moving, stop, converged
    descent.problem, descent.scales = resting, scales
    return x, *end


def _scales(x: FloatArray) -> FloatArray:
    """Return the size each parameter is searched on; a friction that came out at zero still needs one."""
    sizes = np.abs(x)
    return np.asarray(np.where(sizes > 0, sizes, np.max(sizes) * 1e-6))


def _starts(descent: Descent, rigid: Estimate, settings: FlexibleDIDIM) -> list[FloatArray]:
    """Return the starts, best first: the paper's at a known frequency, else the best of a grid."""
    problem = descent.problem
    cutoff = problem.filtering.cutoff
    assert cutoff is not None
    paper = settings.frequency is not None and settings.minimiser == "nelder-mead"
    frequencies = [settings.frequency] if settings.frequency else [guess * cutoff for guess in _GUESSES]
    grid = [(f, share) for f in frequencies for share in _SHARES]
    given = {p.name: p.start for p in problem.parameters if p.start is not None}
    made = [{p.name: 0.0 for p in problem.parameters} | pseudo_regular(rigid.values, *at) | given for at in grid]
    starts = [problem.vector(values) for values in made]
    descent.scales = _scales(starts[0])
    lower, upper = (np.array([getattr(p, side) for p in problem.free]) for side in ("lower", "upper"))
    floor = np.where(np.isfinite(lower), lower + 1e-3 * descent.scales, lower)
    starts = [np.minimum(np.maximum(x, floor), np.maximum(upper - 1e-3 * descent.scales, lower)) for x in starts]
    costs = [float(np.linalg.norm(error)) for error in in_threads(problem.residual, starts)]
    descent.simulations += len(starts)
    order = np.argsort(costs)
    if paper and costs[0] <= descent.size:  # (13) as printed, where its loop can be simulated
        order = np.array([0])
    elif paper:
        descent.progress("the halved inertia (13) makes an unstable loop here; starting from another load share")
    descent.note(starts[order[0]], costs[order[0]])
    return [starts[i] for i in order[: 2 if settings.frequency else _REFINED]]


def _covariance(descent: Descent, x: FloatArray, error: FloatArray, settings: FlexibleDIDIM) -> tuple[Covariance, str]:
    if settings.statistics == "sensitivities":
        J = -descent.jacobian(x)
        covariance = sandwich(J, J, error)
        return covariance, f"from the output sensitivities, {words(covariance)}"
    descent.simulations += 1
    return (
        inverse_model_covariance(descent.problem, x, error),
        "the paper's: of the inverse model on the simulated motion, which is not what was solved; far too small",
    )


def inverse_model_covariance(problem: Problem, x: FloatArray, error: FloatArray) -> Covariance:
    """Return the paper's covariance of the joint's free parameters, ``s^2 (W' W)^-1`` with W on the simulated motion.

    It is that of a regression on W, which is not what torque-only identification solves: for a flexible joint the
    output sensitivities are not W, and Fv1, Fv2 come out many times surer than they are.
    """
    run = problem.simulate(x)
    columns = problem.loop.joint.regressor(run.motor, run.load)
    names = [p.name for p in problem.loop.joint.parameters]
    free = [names.index(p.name) for p in problem.free_joint]
    W = np.concatenate([problem.filtered(equation[:, free]) for equation in columns])
    variance = float(error @ error) / (len(W) - W.shape[1])  # the paper's r counts the rows of both equations
    norms = np.linalg.norm(W, axis=0)
    inverse = np.linalg.inv((W / norms).T @ (W / norms))
    roots = np.sqrt(np.diag(inverse))
    return Covariance(np.sqrt(variance) * roots / norms, inverse / np.outer(roots, roots), 0)


def refined_least_squares(problem: Problem, start: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares parameters near a start, and the sensitivities there, filtered (rows, parameters)."""
    descent = Descent(problem, silent)
    descent.scales = np.where(start != 0.0, np.abs(start), 1.0)
    found = refined(descent, start, tolerance)
    return np.asarray(found.x), -np.asarray(found.jac)
