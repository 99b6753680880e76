"""Predict the intervals of a planned test, from exact sensitivities at rough parameters.

The loop is simulated along the planned reference and injection. The derivatives J of the torque pass the
identification's filter. With S the covariance of ``J' e``, e the filtered torque error from noise::

    cov = (J' J)^-1  S  (J' J)^-1

S depends on the known noise (`Noise`):

- white noise on the logged torque, or a white force on the motor: S is the mean of ``(J' e)(J' e)'`` over simulated
  runs, since friction hides a force and the loop colours it. Of one run it is taken from the spectrum of e: roughly, as
  a search asks for many tests.
- the residual of a first record: it keeps its spectrum, and each interval is scaled as that record's reported interval
  relative to the one by spectrum. This includes repeatable errors.

The identification is the least squares of `DIDIM` with free initial position and, with an integral, torque. Bounds,
saturation most of the time, and failed searches are not predicted.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import POSITION_UNIT, Parameter
from jointid.diagnostics.intervals import rebuild_problem
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, beginning_position, torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import REFERENCE
from jointid.models.joints import ClosedLoop
from jointid.planning.encoders import Source, add_information, encoder_information
from jointid.records.record import Channel, Injection, InjectionPoint, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Outcome, Simulation, require_success
from jointid.simulation.loop_input import to_log
from jointid.simulation.robots import RobotSimulation
from jointid.uncertainty.covariance import Covariance, Influence, covariance_of

_SAME = 1e-13  # of the largest eigenvalue of the information: what is below is rounding
_PART = 1e-3  # of a direction, that a parameter takes
PEAKS = 4.0
"""Deviations of the noise on top of what a test asks for: of 24,000 samples one or two are larger."""
RUNS = 200
"""Runs of the loop with noise, from which its effect is known to 5 %."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Disturbances of a test; all given ones act together.

    Attributes:
        log: standard deviation of white noise on each logged torque, in its unit.
        force: the same of a white force on the motor, held over each period of the controller.
        left: (rows,) filtered residual that the identification of a first record left.
        wider: of each parameter, by how much its interval was reported wider than that residual's spectrum makes it.
    """

    log: float = 0.0
    force: float = 0.0
    left: FloatArray | None = None
    wider: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.log >= 0 and self.force >= 0 and math.isfinite(self.log + self.force)):
            raise MethodError(
                f"Noise has a standard deviation of 0 or more; received {self.log:g} on the log and {self.force:g} in "
                "the loop."
            )
        if self.log == self.force == 0.0 and self.left is None:
            raise MethodError(
                "Without noise every interval is 0; give the noise of the log, a force, or a first record."
            )

    @property
    def source(self) -> Source:
        """Where it is from; of a residual, which does not tell it, the loop: that gives the wider intervals."""
        return "log" if self.left is None and self.log > self.force else "loop"

    @classmethod
    def of(cls, estimate: Estimate, record: Record) -> Noise:
        """Noise from the residual of a first record, by DIDIM with all parameters identified.

        Raises:
            MethodError: the estimate is not of a simulated loop as declared, or not of this record, or refuses a value.
        """
        problem, x = rebuild_declared_problem(estimate, record)
        if any(p.value is None or p.stderr is None for p in estimate.params.rows if p.free):
            raise MethodError(
                "The noise of a first record is taken from an estimate that gives every parameter, and this record "
                "does not identify all: jointid.design takes rough values."
            )
        error, slopes = problem.linearise(x)
        alone = Influence(-slopes, error).stationary().std
        reported = {p.name: p.stderr for p in estimate.params.rows}
        wider = {
            p.name: (reported.get(p.name) or std) / std for p, std in zip(problem.free, map(float, alone), strict=True)
        }
        return cls(left=error, wider=wider)


def rebuild_declared_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the problem an estimate solved and its free parameters, 0 for those not identifiable.

    Raises:
        MethodError: it is not of a simulated loop as it was declared, or of another record.
    """
    estimate.require_joint()
    if estimate.settings.loop is None:
        raise MethodError(
            "A prediction needs an estimate by DIDIM, which simulates its loop; this one is by "
            f"{estimate.settings.method}."
        )
    another = (
        f"The estimate is of {estimate.data.record}, and {record.name} holds another torque; give the record it is of."
    )
    problem, x = rebuild_problem(estimate, record, another)
    freed = [p.name for p in estimate.params.rows if p.free and not p.of_joint]
    if any(name not in INITIAL for name in freed):
        raise MethodError(
            f"A prediction takes the loop as declared, and here {', '.join(freed)} was free; identify with those fixed."
        )
    return problem, x


@dataclass(frozen=True, slots=True, eq=False)
class PredictedTest:
    """The predicted intervals of a test, and its maxima.

    Attributes:
        name: of the test.
        joint: names of the free parameters, in their order.
        symbols, units, values: of these, by name.
        covariance: of their errors.
        torques: (axes, samples) along the test, without noise.
        sample_time: of the torques, s.
        reached: of each axis the largest of each quantity that may be limited, by name.
        motion: of the loop along the test, without noise; None of a robot alone.
        reference, injected: (samples,) what a joint's is driven with.
    """

    in_json = "std -covariance -motion -reached"
    name: str
    joint: tuple[str, ...]
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    values: Mapping[str, float]
    covariance: Covariance
    torques: FloatArray
    sample_time: float
    reached: tuple[Mapping[str, float], ...]
    motion: Simulation | RobotSimulation | None = None
    reference: FloatArray | None = None
    injected: FloatArray | None = None

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.joint, map(float, self.covariance.std), strict=True))

    def widen(self, each: Sequence[FloatArray]) -> PredictedTest:
        """Return the prediction with the widest of deviations at several joints or robots; the first is this one's.

        Args:
            each: (parameters,) standard deviations, of the known one first.
        """
        with np.errstate(invalid="ignore"):
            factors = np.nan_to_num(np.max(each, axis=0) / each[0], nan=1.0, posinf=np.inf)
        return replace(self, covariance=replace(self.covariance, std=self.covariance.std * factors))

    def std_of(self, weights: Mapping[str, float]) -> float:
        """Return the standard deviation of a weighted sum of parameters."""
        return self.covariance.std_of(np.array([weights.get(name, 0.0) for name in self.joint]))


def planned_record(
    loop: ClosedLoop, reference: FloatArray, sample_time: float, injected: FloatArray | None = None,
    *, at: InjectionPoint = InjectionPoint.AFTER_LIMIT, in_torque: bool = True, tap: Tap | str = Tap.COMMAND,
) -> Record:  # fmt: skip
    """Return a test as a record without torque, as the drive is to play it.

    Args:
        loop: whose joint sets the units.
        reference: (samples,) commanded position, m or rad.
        sample_time: of reference and log, s.
        injected: (samples,) a signal added to the torque, in its unit.
        at: where it is added; see `Injection`.
        in_torque: whether the logged torque will contain it.
        tap: where the torque will be logged.
    """
    unit, position = loop.joint.force_unit, POSITION_UNIT[loop.joint.kind]
    added = None if injected is None else Injection(Channel(injected, unit, sample_time, Timing.HELD), at, in_torque)
    velocity = None
    if "reference_velocity" in loop.controller.channels:
        velocity = Channel(np.gradient(reference, sample_time), f"{position}/s", sample_time)
    commanded = Channel(reference, position, sample_time)
    return Record(reference=commanded, reference_velocity=velocity, injected=added, tap=Tap(tap), name="test")


def predict_joints(
    loop: ClosedLoop,
    joints: Iterable[Mapping[str, float]],
    test: Record,
    noise: Noise,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    encoders: tuple[float | None, float | None] = (None, None),
    runs: int = RUNS,
) -> Iterator[PredictedTest]:
    """Predict the intervals of a test at several joints, each with noise of its own.

    Args:
        loop: joint and controller.
        joints: values of every parameter of the joint by name, roughly known.
        test: a record without torque; a past record also serves, its torque is ignored.
        noise: disturbances of the test.
        filtering: of the identification; see `Filtering`.
        parameters: changes to the joint's parameters by name, as for `identify`: those that are fixed.
        encoders: steps of encoders on motor and load, m or rad, that are read beside the torque; None without one.
        runs: of the loop with noise; of one the spectrum is taken.

    Raises:
        MethodError: the loop cannot be simulated, or the torque does not depend on a parameter.
        RecordError: the test lacks what the controller reads.
    """
    problem = _pose(loop, test, filtering or Filtering(), parameters or {})
    free, reference = problem.free_joint, test.reference
    assert reference is not None
    names, own = tuple(p.name for p in free), len(free)
    wider = np.array([noise.wider.get(p.name, 1.0) for p in problem.free])
    for seed, values in enumerate(joints):
        x = _place(problem, values)
        run = require_success(problem.simulate(x))
        response, columns = problem.sensitivities(x)
        if response.outcome is not Outcome.FINISHED:
            raise MethodError(f"The loop cannot be simulated along this test ({response.outcome.value}).")
        J = problem.filter(columns)
        _require_identifiable(problem, J)
        errors = _draw_errors(problem, x, noise, runs, seed)
        matrix = _scatter(problem, J, errors)
        if noise.left is not None:
            matrix = matrix + Influence(J, np.resize(noise.left, len(J))).stationary().matrix * np.outer(wider, wider)
        if encoders != (None, None):
            residual = errors[0] if noise.left is None else _whiten(noise.left, run.torque.size)
            disturbed = replace(problem, measured=run.torque + residual)
            matrix = add_information(matrix, encoder_information(disturbed, x, noise.source, encoders))
        yield PredictedTest(
            test.name, names, {p.name: p.symbol for p in free}, {name: problem.units[name] for name in names},
            {name: values[name] for name in names}, covariance_of(matrix[:own, :own]), run.torque[np.newaxis],
            problem.sample_time, (_find_reached(run, reference, noise, errors),), run, reference.values,
            None if test.injected is None else test.injected.channel.values,
        )  # fmt: skip


def predict_test(
    loop: ClosedLoop, values: Mapping[str, float], test: Record, noise: Noise, **asked: Any
) -> PredictedTest:
    """Predict the intervals of a test of one joint; see `predict_joints`."""
    return next(predict_joints(loop, (values,), test, noise, **asked))


def reach(
    loop: ClosedLoop,
    values: Mapping[str, float],
    test: Record,
    noise: Noise,
    filtering: Filtering,
    parameters: Mapping[str, Parameter],
) -> Mapping[str, float]:
    """Return the maxima of a test's limited quantities, even of an uninformative one; see `predict_joints`."""
    problem = _pose(loop, test, filtering, parameters)
    x = _place(problem, values)
    assert test.reference is not None
    run = require_success(problem.simulate(x))
    return _find_reached(run, test.reference, noise, _draw_errors(problem, x, noise, 1))


def _find_reached(
    run: Simulation, reference: Channel, noise: Noise, errors: Sequence[FloatArray]
) -> Mapping[str, float]:
    """Maxima of a run with its noise added to its torque."""
    size = 0.0 if noise.left is None else float(np.mean(noise.left**2))
    size += float(np.mean(np.square(errors))) if errors else 0.0
    torque = run.torque + PEAKS * math.sqrt(size) * np.sign(run.torque)
    found = find_maxima(run, reference.values, torque, reference.sample_time)
    return found | {"rms_torque": math.sqrt(float(np.mean(run.torque**2)) + size)}


def _pose(
    loop: ClosedLoop, test: Record, filtering: Filtering, parameters: Mapping[str, Parameter]
) -> ClosedLoopProblem:
    """The identification problem of a test, with zero torque."""
    reference = test.reference
    if reference is None:
        raise MethodError("A test needs a reference; give the position that the axis is to follow.")
    torque = test.torque
    if torque is None:
        zeros = np.zeros(math.floor(test.duration / reference.sample_time + 1e-9))
        torque = Channel(zeros, loop.joint.force_unit, reference.sample_time, Timing.HELD)
    played = replace(test, torque=replace(torque, values=np.zeros(len(torque))))
    own = tuple(parameters.get(p.name, p) for p in loop.joint.parameters)
    return torque_problem(played, loop, filtering, own).keeping({"initial_velocity": 0.0})


def _place(problem: ClosedLoopProblem, values: Mapping[str, float]) -> FloatArray:
    """Free parameters of a joint that starts at rest."""
    held = _holding_torque(problem.loop, values, float(problem.experiment.inputs[0, REFERENCE]))
    position = beginning_position(replace(problem, measured=np.full_like(problem.measured, held)))
    around = {"initial_position": position, "initial_velocity": 0.0, "initial_torque": held}
    return problem.vector({**values, **around})


def _holding_torque(loop: ClosedLoop, values: Mapping[str, float], position: float) -> float:
    """Torque that holds a joint at rest at a position."""
    gravity, ripple, offset = loop.joint.gravity, loop.joint.ripple, values.get("offset", 0.0)
    here, forces = np.array([position]), list[tuple[FloatArray, tuple[Parameter, ...]]]()
    forces += [] if gravity is None else [(gravity.columns(here)[0], gravity.parameters)]
    forces += [] if ripple is None else [(ripple.columns_at(here)[0], ripple.parameters)]
    return offset + sum(float(columns @ [values[p.name] for p in own]) for columns, own in forces)


def _require_identifiable(problem: ClosedLoopProblem, J: FloatArray) -> None:
    """Refuse a test whose torque does not depend on a parameter, or a combination."""
    norms = np.linalg.norm(J, axis=0)
    norms[norms == 0.0] = 1.0
    sizes, directions = np.linalg.eigh((J / norms).T @ (J / norms))
    free = directions[:, sizes <= _SAME * max(float(sizes[-1]), 1.0)]
    untold = [p.name for p, row in zip(problem.free_joint, free, strict=False) if np.any(np.abs(row) > _PART)]
    if untold:
        raise MethodError(
            f"This test does not tell {', '.join(untold)}: the torque would be the same for other values; move the "
            "axis, in both directions and at several speeds."
        )


def _whiten(left: FloatArray, samples: int) -> FloatArray:
    """Return white noise of the size of a residual, (samples,)."""
    size = float(np.sqrt(np.mean(left**2)))
    return np.asarray(size * np.random.default_rng(0).standard_normal(samples))


def _scatter(problem: ClosedLoopProblem, J: FloatArray, errors: Sequence[FloatArray]) -> FloatArray:
    """Return the covariance of all free parameters from runs with noise, (free, free); of one by its spectrum."""
    if len(errors) == 1:
        return Influence(J, problem.filter(errors[0])).stationary().matrix
    norms = np.linalg.norm(J, axis=0)
    norms[norms == 0.0] = 1.0
    inverse = np.linalg.pinv((J / norms).T @ (J / norms))
    weights = (J / norms) @ inverse.T / norms  # (rows, free): what an error of the torque does to each parameter
    moved = np.array([problem.filter(one) @ weights for one in errors]).reshape(-1, J.shape[1])
    return np.asarray(moved.T @ moved / max(len(moved), 1))


def _draw_errors(problem: ClosedLoopProblem, x: FloatArray, noise: Noise, runs: int, seed: int = 0) -> list[FloatArray]:
    """Return the noise in the logged torque for each run, raw, (samples,) each; none of a first record's alone."""
    if noise.log == noise.force == 0.0:
        return []
    experiment, quiet = problem.experiment, problem.torque(x)

    def error(number: int) -> FloatArray:
        rng = np.random.default_rng([seed, number])
        added = noise.log * rng.standard_normal(quiet.size)
        if noise.force > 0:
            force = noise.force * rng.standard_normal(experiment.after_limit.size)
            forced = replace(experiment, after_limit=experiment.after_limit + force)
            run = replace(problem, experiment=forced).torque(x)
            # The log shows what the loop does about the force, and not the force itself.
            added = added + run - quiet - to_log(experiment, forced.shown - experiment.shown)
        return added

    return in_threads(error, range(runs))


def find_maxima(run: Simulation, reference: FloatArray, torque: FloatArray, sample_time: float) -> dict[str, float]:
    """Maxima of the limited quantities in a simulated test.

    Args:
        run: of the loop.
        reference: (samples,) of it, m or rad.
        torque: (samples,) that acts on the joint.
        sample_time: of the reference, s.
    """
    positions = [run.motor_position, *([] if run.load_position is None else [run.load_position])]
    velocities = [run.motor_velocity, *([] if run.load_velocity is None else [run.load_velocity])]
    acceleration = np.diff(reference, 2) / sample_time**2
    jerk = np.diff(acceleration) / sample_time
    low, high = (f([f(one) for one in (*positions, reference)]) for f in (np.min, np.max))
    windup = {}
    if run.load_position is not None:
        windup["windup"] = float(np.max(np.abs(run.load_position - run.motor_position)))
    return {
        "stroke": float(high - low),
        "speed": max(float(np.max(np.abs(one))) for one in velocities),
        "acceleration": float(np.max(np.abs(acceleration), initial=0.0)),
        "jerk": float(np.max(np.abs(jerk), initial=0.0)),
        "torque": float(np.max(np.abs(torque))),
        "rms_torque": math.sqrt(float(np.mean(torque**2))),
        **windup,
    }
