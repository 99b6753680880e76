"""The problem of one joint: free parameters in, the filtered torque error and its slopes out.

It is `Simulated` along one log of one axis. Its parameters are those of the joint, then those of what surrounds it
(`estimation.parameters`). The motor is moved by its controller, or as it moved (`methods.drive_side`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter
from jointid.estimation.parameters import INITIAL_STATE, INITIAL_TORQUE, surrounding
from jointid.estimation.problems.simulated import Simulated, loop_log
from jointid.models.controllers import POSITION, REFERENCE, Controller
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering, drop_ends
from jointid.simulation.drive_side import DriveSide
from jointid.simulation.loop_input import AxisInput, LoopInput, prepare
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import Run, Simulation
from jointid.uncertainty.position_dependent_error import Cells, cells


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoopProblem(Simulated):
    """The torque of one record against the simulation of one joint.

    Of a loop the filter's borders are left out of the reported error, not of the residual, because the first samples
    hold what is known of the initial state and no position is differentiated.

    Attributes:
        parameters: all of the joint, then of what surrounds it.
        system: what is simulated.
    """

    parameters: tuple[Parameter, ...]  # type: ignore[assignment]
    system: ClosedLoop | DriveSide

    @property
    def joint(self) -> Joint:
        """The joint."""
        return self.system.joint

    @property
    def loop(self) -> ClosedLoop:
        """The joint and its controller."""
        assert isinstance(self.system, ClosedLoop)
        return self.system

    @property
    def axis(self) -> AxisInput:
        """The inputs of the joint's controller."""
        experiment: LoopInput = self.log.experiment
        return experiment.axis

    @property
    def measured(self) -> FloatArray:
        """The torque, (samples,)."""
        torque: FloatArray = self.log.measured[:, 0]
        return torque

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """Those of them that belong to the joint; they come first."""
        return tuple(p for p in self.parameters[: len(self.joint.parameters)] if p.free)

    @property
    def around(self) -> tuple[Parameter, ...]:
        """The parameters of what surrounds the joint."""
        return self.parameters[len(self.joint.parameters) :]

    @property
    def units(self) -> dict[str, str]:
        """Of every parameter, by name."""
        return {p.name: self.joint.unit(p) for p in self.parameters}

    @property
    def keys(self) -> list[Place]:
        """Places of the derivatives of a simulation, (free,)."""
        return [Place(0, p.name) for p in self.free]

    def scales(self, x: FloatArray) -> FloatArray:
        """Return 1 for each free parameter, which is searched itself."""
        return np.ones(x.size)

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found.get(p.name, float(p.start or 0.0)) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order; one that is not there starts as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

    def numbers(self, x: FloatArray) -> Numbers:
        """Return the numbers of a candidate: those of the joint, and of what surrounds it."""
        return Numbers.of_joint(self.joint, self.values(x))

    # Other problems

    def replace_parameters(self, changes: Mapping[str, Parameter]) -> ClosedLoopProblem:
        """Return the problem with the parameters of these names replaced; others are not added."""
        return replace(self, parameters=tuple(changes.get(p.name, p) for p in self.parameters))

    def keeping(self, values: Mapping[str, float]) -> ClosedLoopProblem:
        """Return the problem with parameters fixed at these values, by name; others are not added."""
        return self.replace_parameters({p.name: p.fix(values[p.name]) for p in self.parameters if p.name in values})

    def freeing(self, *names: str) -> ClosedLoopProblem:
        """Return the same problem with more of what surrounds the joint free.

        Raises:
            MethodError: nothing around the joint has that name.
        """
        new = [surrounding(name, self.loop.controller, self.axis.law.period) for name in names]
        kept = tuple(p for p in self.parameters if p.name not in names)
        return replace(self, parameters=(*kept, *new))

    def with_joint(self, joint: Joint, own: Sequence[Parameter] | None = None) -> ClosedLoopProblem:
        """Return the problem of another joint, with its parameters, or those of this one where it has them."""
        given = {p.name: p for p in self.parameters}
        own = [replace(given.get(p.name, p), symbol=p.symbol) for p in joint.parameters] if own is None else own
        return replace(self, system=replace(self.system, joint=joint), parameters=(*own, *self.around))

    def with_log(self, **changes: object) -> ClosedLoopProblem:
        """Return the problem of another log."""
        return self.map_logs(lambda log: replace(log, **changes))

    def under(self, controller: Controller, record: Record | None = None) -> ClosedLoopProblem:
        """Return the problem with another controller: of the same period and delay, or with its record prepared for it.

        Raises:
            RecordError, MethodError: the record, or the law, cannot be at that period.
        """
        loop, experiment = replace(self.loop, controller=controller), self.log.experiment
        driven = experiment.under(controller) if record is None else prepare(loop, record)
        return replace(self.with_log(experiment=driven), system=loop)

    # Its answers

    def filter(self, columns: FloatArray) -> FloatArray:
        """Return signals, (samples,) or (samples, columns), through the problem's own filter, decimated."""
        return np.asarray(self.log.decimate_joint(0, columns))

    def filtered_error(self, error: FloatArray) -> float:
        """Return the norm of a filtered error, (rows,), over that of the filtered signal, a ratio."""
        return float(np.linalg.norm(error) / self.size)

    def axis_at(self, x: FloatArray) -> AxisInput:
        """Return the inputs of the controller with the numbers that these parameters say."""
        experiment: LoopInput = self.log.under(self.numbers(x))
        return experiment.axis

    def loop_at(self, x: FloatArray) -> ClosedLoop:
        """Return the loop with the controller's numbers that these parameters say."""
        return replace(self.loop, controller=self.axis_at(x).controller)

    def simulate(self, x: FloatArray) -> Simulation:
        """Return the loop's run with these parameters, its torque as the log should show it."""
        (run,) = self.run(x)
        return replace(Simulation.of(run), torque=self.log.predict(run)[:, 0])

    def torque(self, x: FloatArray, driven: Callable[[AxisInput], AxisInput] | None = None) -> FloatArray:
        """Return the torque the log should show, raw, (samples,); `driven` changes what drives the loop."""
        log, numbers = self.log, self.numbers(x)
        run = log.run(numbers, keep=False) if driven is None else log.run(numbers, keep=False, driven=driven)
        return np.asarray(log.predict(run)[:, 0])

    def sensitivities(self, x: FloatArray) -> tuple[FloatArray, Run, FloatArray]:
        """Return the predicted torque, its run, and its derivatives by the free parameters, (samples, free), raw."""
        (run,) = self.run(x)
        return self.log.predict(run)[:, 0], run, self.log.columns(run, self.keys)[0]

    @property
    def kept(self) -> NDArray[np.intp]:
        """The samples that rows of the residual are taken at, (rows,): the last one, if no ends are dropped."""
        samples, keep = self.measured.size, self.filtering.decimation or 1
        rows = np.arange((samples - 1) % keep, samples, keep)
        return drop_ends(rows, self.filtering, samples) if any(self.log.seen) else rows

    def cells(self, simulation: Simulation) -> Cells:
        """Return the cell of position and velocity of the simulated motor for each row of the residual."""
        return cells(simulation.motor_position[self.kept], simulation.motor_velocity[self.kept])


def beginning_position(problem: ClosedLoopProblem, velocity: float = 0.0, torque: float | None = None) -> float:
    """Compute the motor position at which the controller outputs the first logged torque.

    With integral action, or without position feedback, this is the first reference.

    A proportional loop lets a load that weighs something sag by the torque that carries it, over its gain. A search
    that begins beside it may not find it: friction holds the motor where it begins. The torque may be another one than
    the first of the log.
    """
    axis = problem.axis
    law = axis.feedback
    home = float(axis.inputs[0, REFERENCE])
    if law.integrates:  # its integral carries the load, and the motor is where it is asked to be
        return home
    gain = law.C[0, law.output] @ axis.memory[:, 0] + law.D[0, law.output, POSITION]
    asked = problem.measured[0] if torque is None else torque
    asked -= axis.shown[0] + axis.feedforward[law.output, 0] + velocity * (law.C[0, law.output] @ axis.memory[:, 1])
    return float(asked / gain) if gain != 0.0 else home


def torque_problem(
    record: Record,
    loop: ClosedLoop,
    filtering: Filtering,
    parameters: tuple[Parameter, ...],
    surroundings: Sequence[Parameter] = INITIAL_STATE,
) -> ClosedLoopProblem:
    """Return the problem of reproducing a record's torque by simulating the loop from its reference.

    Raises:
        RecordError: the record lacks a channel the loop needs.
        MethodError: no parameter of the joint is free, or the filtering is impossible.
    """
    require_free(parameters)
    log = loop_log(loop, [record], loop.joint.model, filtering)
    # Of positions alone the content of an integral is one with a constant torque of the joint.
    lacks = all(p.name != INITIAL_TORQUE.name for p in surroundings) and not any(log.seen)
    first = replace(INITIAL_TORQUE, start=float(log.measured[0, 0]))
    around = (*surroundings, first) if lacks and log.experiment.axis.law.integrates else surroundings
    return ClosedLoopProblem((log,), (*parameters, *around), np.ones(1), loop)


def require_free(parameters: tuple[Parameter, ...]) -> None:
    """Raise a `MethodError` if no parameter of a joint is free."""
    if not any(p.free for p in parameters):
        raise MethodError(
            "Every parameter of the joint is fixed, or of its linear laws, so no search can begin; free one."
        )
