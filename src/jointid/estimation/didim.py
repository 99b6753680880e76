"""DIDIM for rigid joints: direct and inverse dynamic identification models, from torque and reference only.

The closed loop is simulated at the current parameters; the inverse dynamic regressor is evaluated on the simulated
motion; least squares on the torque gives the next parameters; until nothing changes [P section IV.A].

The paper's form (11) solves ``tau = W chi``, which does not hold while an axis rests: friction then takes what it
must, not Fc. The residual form ``tau - tau_sim = W dchi`` has the truth as its fixed point wherever the axis rests,
and is the default. Both read W on the simulation, which the noise of the record cannot reach, so W acts as a set
of instruments and the standard deviations are those of an instrumental-variable estimator::

    cov = s^2 (W' J)^-1 (W' W) (J' W)^-1,     J = d tau_sim / d chi, the output sensitivities
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.data.record import FloatArray, Record
from jointid.data.signals import Filtering
from jointid.estimation.estimate import Estimate, EstimatedParameter, Iteration, fingerprint, relative_error
from jointid.estimation.problem import Problem, initial_of, torque_problem
from jointid.estimation.regression import least_squares
from jointid.estimation.starts import given_start, inversion_start, regular_start
from jointid.model.parameters import Parameter
from jointid.simulation.closed_loop import ClosedLoop, Outcome, Simulation, simulate

_ROUNDING = 1e-10  # of the torque: an error this small is rounding
_HALVINGS = 8  # of a step that makes things much worse
_INSEPARABLE = 0.98  # a correlation that says two parameters are known only together
_WORSE = 2.0  # times the residual: with an approximate Jacobian, a little worse is no reason to turn back


@dataclass(frozen=True, slots=True)
class DIDIM:
    """Settings of DIDIM.

    Attributes:
        form: "residual" (see the module), or "paper": (11) as printed.
        start: "inversion" of the controller; "regular": a regular inertia, no friction; "given": the starts of the
            parameters.
        scaled_iterations: for how many first iterations the simulated controller's gains are scaled with the
            inertia, from a regular or a given start. Scaling at every iteration would bias the result where the
            bandwidth it assumes is not the real one, so it always ends on the true gains.
        tolerance: stop when the residual norm changes by at most this share ...
        step_tolerance: ... and no parameter by more than this share of itself.
        iterations: at most.
        initial_state: "free" estimates the motor's position and velocity at the first sample; "reference" puts it
            on the reference, at rest.
    """

    form: Literal["residual", "paper"] = "residual"
    start: Literal["inversion", "regular", "given"] = "inversion"
    scaled_iterations: int = 2
    tolerance: float = 1e-7
    step_tolerance: float = 1e-7
    iterations: int = 30
    initial_state: Literal["free", "reference"] = "free"

    def __post_init__(self) -> None:
        choices = {
            "form": (self.form, ("residual", "paper")),
            "start": (self.start, ("inversion", "regular", "given")),
            "initial_state": (self.initial_state, ("free", "reference")),
        }
        for name, (value, allowed) in choices.items():
            if value not in allowed:
                raise MethodError(f'DIDIM\'s {name} is one of {", ".join(allowed)}; received "{value}".')
        if self.iterations < 1 or self.scaled_iterations < 0 or min(self.tolerance, self.step_tolerance) <= 0:
            raise MethodError(
                "DIDIM needs at least 1 iteration, 0 or more scaled iterations, and positive tolerances; received "
                f"{self.iterations}, {self.scaled_iterations}, {self.tolerance} and {self.step_tolerance}."
            )

    @classmethod
    def paper(cls) -> DIDIM:
        """Return the settings of the paper: form (11), regular start, stop at 2.5 % or after 10 iterations."""
        return cls("paper", "regular", 1, 0.025, 0.025, 10, "reference")


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """One iterate: where the search is, and what it costs."""

    x: FloatArray
    simulation: Simulation
    error: FloatArray
    gain_scale: float

    @property
    def norm(self) -> float:
        return float(np.linalg.norm(self.error))


class _Search:
    """One search: the iterates, the trace and the count of simulations."""

    def __init__(self, problem: Problem, settings: DIDIM, progress: Progress) -> None:
        self.problem, self.settings, self.progress = problem, settings, progress
        self.trace: list[Iteration] = []
        self.simulations = 0
        self.size = float(np.linalg.norm(problem.filtered(problem.measured)))

    def evaluate(self, x: FloatArray, gain_scale: float = 1.0) -> _State:
        """Simulate one candidate, with the controller's gains scaled."""
        problem = self.problem
        values = problem.values(x)
        experiment = problem.experiment if gain_scale == 1.0 else problem.experiment.scaled(gain_scale)
        simulation = simulate(problem.loop, experiment, values, initial_of(values))
        self.simulations += 1
        return _State(x, simulation, problem.error(simulation), gain_scale)

    def note(self, state: _State, before: _State | None) -> Iteration:
        """Add a line to the trace."""
        change = step = None
        if before is not None:
            change = abs(state.norm - before.norm) / before.norm if before.norm else 0.0
            columns = self.problem.regressor(state.simulation)
            scales = self.problem.scales(state.x, columns)
            step = float(np.max(np.abs(state.x - before.x)[: scales.size] / scales))
        line = Iteration(
            len(self.trace),
            self.problem.values(state.x),
            state.norm,
            change,
            step,
            self.simulations,
            state.gain_scale,
        )
        self.trace.append(line)
        self.progress(f"iteration {line.number}: torque error {100 * state.norm / self.size:.4f} %")
        return line

    def columns(self, state: _State) -> FloatArray:
        """Return the raw columns of the step: the regressor, then the initial state's derivatives."""
        W = self.problem.regressor(state.simulation)
        surrounding = slice(W.shape[1], None)
        J, runs = self.problem.jacobian(state.x, self.problem.scales(state.x, W), surrounding)
        self.simulations += runs
        return np.hstack([W, J])

    def scaled_step(self, state: _State) -> FloatArray:
        """Return the parameters that form (11) gives on a motion under scaled gains."""
        return self.solved(state, self.problem.regressor(state.simulation))

    def solved(self, state: _State, W: FloatArray) -> FloatArray:
        """Solve ``tau = W chi`` for the joint; what surrounds it stays."""
        problem = self.problem
        fixed = problem.loop.joint.parameters
        kept = [0.0 if p.free else problem.values(state.x)[p.name] for p in problem.parameters[: len(fixed)]]
        full = problem.loop.joint.regressor(state.simulation.velocity, state.simulation.acceleration)  # type: ignore[union-attr]
        both = problem.filtered(np.column_stack([problem.measured - full @ np.array(kept), W]))
        names = tuple(p.name for p in problem.free_joint)
        chi = least_squares(both[:, 1:], both[:, 0], names).values
        return np.concatenate([chi, state.x[chi.size :]])

    def step(self, state: _State) -> FloatArray:
        """Return the next parameters."""
        W = self.columns(state)
        if self.settings.form == "paper":
            joint = len(self.problem.free_joint)
            after = self.solved(state, W[:, :joint])
            if W.shape[1] == joint:
                return after
        names = tuple(p.name for p in self.problem.free)
        change = least_squares(self.problem.filtered(W), state.error, names).values
        if self.settings.form == "paper":  # the initial state has no inverse model: it always takes the residual form
            return np.concatenate([after[:joint], (state.x + change)[joint:]])
        return np.asarray(state.x + change)

    def advance(self, state: _State) -> _State:
        """Take a step, halved while it fails or makes things much worse."""
        after = self.evaluate(self.step(state))
        for _ in range(_HALVINGS):
            failed = after.simulation.outcome is not Outcome.FINISHED
            if not failed and after.norm <= _WORSE * state.norm:
                break
            after = self.evaluate(0.5 * (after.x + state.x))
        return after

    def run(self, x: FloatArray, nominal_inertia: float | None) -> tuple[_State, str, bool]:
        """Search from `x`; return where it ended, why, and whether that is a good end."""
        settings = self.settings
        scaled = settings.scaled_iterations if nominal_inertia else 0

        def scale(at: FloatArray) -> float:
            return float(self.problem.values(at)["inertia"]) / nominal_inertia if nominal_inertia else 1.0

        state = self.evaluate(x, scale(x) if scaled else 1.0)
        self.note(state, None)
        for number in range(1, settings.iterations + 1):
            _require_simulated(state)
            if number <= scaled:
                x = self.scaled_step(state)
                after = self.evaluate(x, scale(x) if number < scaled else 1.0)
            else:
                after = self.advance(state)
            line = self.note(after, state)
            before, state = state, after
            if number <= scaled:
                continue
            if state.norm <= _ROUNDING * self.size:
                return state, "the torque is reproduced to rounding", True
            assert line.change is not None
            assert line.step is not None
            if line.change <= settings.tolerance and line.step <= settings.step_tolerance:
                return state, _converged(line, settings), True
            if before.norm < state.norm and state.norm > _WORSE * before.norm:
                break
        _require_simulated(state)
        last = self.trace[-1]
        return (
            state,
            f"not converged: after {last.number} iterations the residual still changes by "
            f"{100 * (last.change or 0.0):.2g} % and a parameter by {100 * (last.step or 0.0):.2g} %",
            False,
        )

    def deviations(self, state: _State) -> tuple[FloatArray, FloatArray]:
        """Return the standard deviations of the free parameters, and their correlations (see the module)."""
        problem = self.problem
        W = self.columns(state)
        joint = len(problem.free_joint)
        J, runs = problem.jacobian(state.x, problem.scales(state.x, W[:, :joint]))
        self.simulations += runs
        Z, J = problem.filtered(W), problem.filtered(J)
        norms = np.linalg.norm(Z, axis=0)
        Z, J = Z / norms, J / norms
        rows, count = Z.shape
        spread = np.linalg.pinv(Z.T @ J)
        variance = float(state.error @ state.error) / max(rows - count, 1)
        covariance = variance * spread @ (Z.T @ Z) @ spread.T
        std = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(std, std) if np.all(std > 0) else np.eye(count)
        return std / norms, correlation


def _converged(line: Iteration, settings: DIDIM) -> str:
    assert line.change is not None
    assert line.step is not None
    return (
        f"converged: the residual changed by {100 * line.change:.1g} % (limit {100 * settings.tolerance:g} %) and no "
        f"parameter by more than {100 * line.step:.1g} % (limit {100 * settings.step_tolerance:g} %)"
    )


def _require_simulated(state: _State) -> None:
    outcome = state.simulation.outcome
    if outcome is not Outcome.FINISHED:
        raise MethodError(
            f"DIDIM cannot go on, because {outcome.value} ({100 * state.simulation.finished:.0f} % of the record was "
            'simulated); check the controller\'s gains and units, or choose start = "regular".'
        )


def identify_didim(
    record: Record,
    loop: ClosedLoop,
    parameters: tuple[Parameter, ...],
    filtering: Filtering,
    settings: DIDIM | None = None,
    progress: Progress = silent,
) -> Estimate:
    """Identify a rigid joint from torque and reference; a motor position in the record is not read.

    Args:
        record: with the torque and what the controller reads.
        loop: rigid joint and controller.
        parameters: of the joint; free ones are estimated.
        filtering: cut-off and decimation of torque and columns alike. Well below the loop's bandwidth, the
            regressor is the Jacobian; above it convergence slows down.
        settings: see `DIDIM`.
        progress: told each iteration.

    Raises:
        RecordError: a channel is missing.
        MethodError: the joint is flexible, the record does not determine the parameters, or the loop cannot be
            simulated at the start.
    """
    settings = settings or DIDIM()
    problem = torque_problem(record, loop, filtering, parameters)
    if settings.initial_state == "reference":
        problem = _at_reference(problem)
    choose = {"inversion": inversion_start, "regular": regular_start, "given": given_start}
    start = choose[settings.start](problem)
    search = _Search(problem, settings, progress)
    state, stop, converged = search.run(problem.vector(start.values), start.nominal_inertia)
    std, correlation = search.deviations(state)
    return _estimate(record, problem, settings, search, state, std, correlation, stop, converged)


def _at_reference(problem: Problem) -> Problem:
    at = {"initial_position": float(problem.experiment.inputs[0, 0]), "initial_velocity": 0.0}
    kept = tuple(p.fixed(at[p.name]) if p.name in at else p for p in problem.parameters)
    return replace(problem, parameters=kept)


def _estimate(
    record: Record,
    problem: Problem,
    settings: DIDIM,
    search: _Search,
    state: _State,
    std: FloatArray,
    correlation: FloatArray,
    stop: str,
    converged: bool,
) -> Estimate:
    values = problem.values(state.x)
    spread = dict(zip((p.name for p in problem.free), map(float, std), strict=True))
    joint = problem.loop.joint
    of_joint = {p.name for p in joint.parameters}
    rows = tuple(
        EstimatedParameter(
            p.name, p.symbol, joint.unit(p), values[p.name], spread.get(p.name), p.free, p.free,
            of_joint=p.name in of_joint,
        )
        for p in problem.parameters
    )  # fmt: skip
    borders = problem.filtering.borders
    used = (*problem.loop.channels, *(("injected",) if record.injected is not None else ()))
    return Estimate(
        method="didim",
        variant=f"DIDIM in {'the paper’s form (11)' if settings.form == 'paper' else 'residual form'} "
        f"from {'an' if settings.start == 'inversion' else 'a'} {settings.start} start",
        joint=joint,
        loop=problem.loop,
        parameters=rows,
        channels=used,
        record=record.name,
        sample_time=problem.experiment.sample_time,
        measured=problem.measured,
        predicted=state.simulation.torque,
        borders=borders,
        relative_error=relative_error(problem.measured, state.simulation.torque, borders),
        filtered_error=state.norm / search.size,
        rows=state.error.size,
        conditioning=None,
        initial=initial_of(values),
        filtering=problem.filtering,
        trace=tuple(search.trace),
        simulations=search.simulations,
        stop=stop,
        converged=converged,
        warnings=_warnings(problem, state, correlation, converged),
        fingerprint=fingerprint(record.torque.values) if record.torque is not None else "",
        delay=problem.experiment.law.delay,
    )


def _warnings(problem: Problem, state: _State, correlation: FloatArray, converged: bool) -> tuple[str, ...]:
    found = [] if converged else ["the search did not converge; the values are where it stopped"]
    names = [p.name for p in problem.free]
    pairs = [
        f"{names[i]} and {names[j]} are hard to tell apart in this record (correlation {correlation[i, j]:+.3f})"
        for i in range(len(problem.free_joint))  # the initial state is no part of the answer
        for j in range(i)
        if abs(correlation[i, j]) > _INSEPARABLE
    ]
    negative = [
        f"{p.name} came out at {value:.4g}, below what is physical"
        for p, value in zip(problem.free, state.x, strict=True)
        if value < p.lower
    ]
    return (*found, *pairs, *negative)
