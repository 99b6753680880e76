"""The problem an estimator solves: a vector of free parameters in, the filtered torque error out.

It owns the record, what closes the loop around the joint, the filter that torque and Jacobian go through alike, and
which parameters are free: those of the joint, then the motor's initial position and velocity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jointid.common.errors import MethodError
from jointid.data.record import FloatArray, Record
from jointid.data.signals import Filtering, decimate
from jointid.model.controllers import REFERENCE
from jointid.model.joints import RigidJoint
from jointid.model.parameters import Parameter, Quantity
from jointid.simulation.closed_loop import Initial, Outcome, Response, Simulation, in_threads, simulate, simulate_torque
from jointid.simulation.experiment import ClosedLoop, Experiment, prepare

INITIAL_STATE = (
    Parameter("initial_position", "q(0)", Quantity.POSITION),
    Parameter("initial_velocity", "v(0)", Quantity.VELOCITY),
)
"""The motor's state at the first sample; an axis may already move when the log begins."""

_INITIAL_NAMES = tuple(p.name for p in INITIAL_STATE)
_STEP = 1e-6  # of central differences, relative: their error is then about 1e-5 of a column
_FLOOR = 1e-3  # a parameter smaller than this share of the torque is measured against that share
_FAILED = 1e3  # times the torque: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The torque of one record against one loop.

    Attributes:
        loop, experiment: what is simulated.
        parameters: all of the joint, then of the initial state.
        measured: (samples,) raw torque.
        filtering: resolved; its borders are left out of the reported error, not of the residual, because the
            first samples hold what is known of the initial state and no position is differentiated.
    """

    loop: ClosedLoop
    experiment: Experiment
    parameters: tuple[Parameter, ...]
    measured: FloatArray
    filtering: Filtering

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """Those of them that belong to the joint; they come first."""
        return tuple(p for p in self.free if p.name not in _INITIAL_NAMES)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        given = {p.name: p.start for p in self.parameters if not p.free}
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found[p.name] if p.free else float(given[p.name] or 0.0) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order."""
        return np.array([values[p.name] for p in self.free])

    def filtered(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), through the problem's own filter."""
        return decimate(columns, self.filtering, self.experiment.sample_time)

    def simulate(self, x: FloatArray) -> Simulation:
        """Return the loop's run with these parameters."""
        values = self.values(x)
        return simulate(self.loop, self.experiment, values, initial_of(values))

    def torque(self, x: FloatArray) -> FloatArray:
        """Return the raw simulated torque, (samples,)."""
        values = self.values(x)
        return simulate_torque(self.loop, self.experiment, values, initial_of(values)).torque

    def error(self, run: Simulation | Response) -> FloatArray:
        """Return the filtered torque error of a run; of one that failed, something large and finite."""
        error = self.measured - run.torque
        if run.outcome is not Outcome.FINISHED:
            # The earlier it failed the worse: a search must see which way to go.
            size = float(np.sqrt(np.mean(self.measured**2)))
            error = np.full_like(error, _FAILED * size * (2.0 - run.finished))
        return self.filtered(error)

    def residual(self, x: FloatArray) -> FloatArray:
        """Return the filtered, decimated torque error, (rows,)."""
        values = self.values(x)
        return self.error(simulate_torque(self.loop, self.experiment, values, initial_of(values)))

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residual, (rows,), and its derivatives by the free parameters, (rows, free)."""
        J, _ = self.jacobian(x, np.maximum(np.abs(x[: len(self.free_joint)]), 1e-6))
        return self.residual(x), -self.filtered(J)

    def regressor(self, simulation: Simulation) -> FloatArray:
        """Return the inverse-dynamic columns of the free joint parameters on a run, raw, (samples, parameters)."""
        if not isinstance(self.loop.joint, RigidJoint):
            raise MethodError(
                "The inverse-dynamic regressor of a simulated flexible joint is no approximation of its Jacobian "
                "(the load is not controlled); identify the joint as rigid, at low frequency."
            )
        columns = self.loop.joint.regressor(simulation.motor)[0]
        names = [p.name for p in self.loop.joint.parameters]
        return np.asarray(columns[:, [names.index(p.name) for p in self.free_joint]])

    def fixed_torque(self, simulation: Simulation) -> FloatArray:
        """Return the torque that the joint's fixed parameters take on a run, (samples,)."""
        joint = self.loop.joint
        assert isinstance(joint, RigidJoint)
        kept = [0.0 if p.free else p.start or 0.0 for p in self.parameters[: len(joint.parameters)]]
        return np.asarray(joint.regressor(simulation.motor)[0] @ np.array(kept))

    def scales(self, x: FloatArray, columns: FloatArray) -> FloatArray:
        """Return the size a change of each joint parameter is measured against: its value, or a small torque's."""
        norms = np.linalg.norm(columns, axis=0)
        floor = _FLOOR * np.linalg.norm(self.measured) / np.where(norms > 0, norms, 1.0)
        return np.asarray(np.maximum(np.abs(x[: norms.size]), floor))

    def jacobian(self, x: FloatArray, scales: FloatArray, only: slice = slice(None)) -> tuple[FloatArray, int]:
        """Return the raw torque's derivatives by the free parameters (or a slice of them), and the simulations run.

        Central differences, shape (samples, parameters); `scales` as from `scales`, for the joint's parameters. At a
        lower bound, below which there may be nothing to simulate, they are taken a step inside it.
        """
        steps = _STEP * np.concatenate([scales, self._initial_scales()])[: x.size]
        chosen = range(x.size)[only]
        inside = [max(p.lower + 2 * step - value, 0.0) for p, value, step in zip(self.free, x, steps, strict=True)]
        shifts = [(inside[i] + sign * steps[i]) * np.eye(x.size)[i] for i in chosen for sign in (1.0, -1.0)]
        runs = in_threads(lambda shift: self.torque(x + shift), shifts)
        pairs = zip(chosen, runs[::2], runs[1::2], strict=True)
        columns = [(above - below) / (2 * steps[i]) for i, above, below in pairs]
        return (np.column_stack(columns) if columns else np.zeros((self.measured.size, 0))), len(runs)

    def _initial_scales(self) -> FloatArray:
        reference = self.experiment.inputs[:, REFERENCE]
        travel = float(np.ptp(reference)) or 1.0
        speed = float(np.max(np.abs(np.diff(reference)))) / self.experiment.law.period or travel
        sizes = {"initial_position": travel, "initial_velocity": speed}
        return np.array([sizes[p.name] for p in self.free if p.name in sizes])


def initial_of(values: Mapping[str, float]) -> Initial:
    """Return the initial state among a problem's values."""
    return Initial(values["initial_position"], values["initial_velocity"])


def torque_problem(
    record: Record,
    loop: ClosedLoop,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    initial: tuple[Parameter, ...] = INITIAL_STATE,
) -> Problem:
    """Return the problem of reproducing a record's torque by simulating the loop from its reference.

    Raises:
        RecordError: the record lacks a channel the loop needs.
        MethodError: no parameter of the joint is free, or the filtering is impossible.
    """
    record.require(loop.channels, "DIDIM")
    assert record.torque is not None
    if not any(p.free for p in parameters):
        raise MethodError("Every parameter of the joint is fixed, so there is nothing to identify; free one of them.")
    experiment = prepare(loop, record)
    measured = record.torque.values[: experiment.samples]
    return Problem(
        loop,
        experiment,
        (*parameters, *initial),
        measured,
        filtering.resolved(experiment.sample_time, loop.joint.model),
    )
