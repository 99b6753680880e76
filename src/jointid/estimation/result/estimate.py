"""The estimate of a joint or robot, its parts, and `build_estimate`."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import write_whole
from jointid.common.parameters import Parameter, find_active_bounds
from jointid.common.text import interval, join, number
from jointid.estimation.methods import method_of
from jointid.estimation.result.agreement import Agreement
from jointid.estimation.result.fields import dumps
from jointid.estimation.result.verdict import Answer, Check, StiffnessBound, Subject, answer_of
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.models.position_forces import Motion
from jointid.models.robots.robot import Robot
from jointid.records.record import Resampled, Timing
from jointid.records.signals.filtering import Filtering
from jointid.uncertainty.covariance import INTERVAL, Covariance
from jointid.uncertainty.identifiability import Identifiability

if TYPE_CHECKING:
    import jointid
    from jointid.estimation.problems.simulated import ClosedLoopProblem
    from jointid.estimation.robots.didim import RobotFit
    from jointid.estimation.robots.simulated import IdentifiedRobot
    from jointid.records.record import Record

_PERIOD = 1e-4  # s, at which two controllers without one of their own are compared


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One row of the table.

    Attributes:
        name, symbol, unit: of the parameter.
        value: the estimate; None when it is refused.
        stderr: its standard error; None for a parameter that was kept fixed, or refused.
        free: whether it was identified.
        lower_bound: supported by the record if the value is refused.
        of_joint: False for the joint's surroundings (the initial state).
        at_bound: the active bound, where it does not follow the record; None without one.
        lack_of_fit: possible shift by unmodelled properties of the joint, as one deviation; it is the same in every
            record of such a motion, so it is no part of `stderr`.
        axis: the joint of a robot; empty for a single joint, and for parameters of all axes.
        formula: for a robot, the sum of its own numbers, or the symbol if it is no sum. Empty for a joint.
        nominal: of the robot as it was given, by IDIM beside fitted friction; None for a joint.
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    free: bool
    lower_bound: float | None = None
    of_joint: bool = True
    at_bound: float | None = None
    lack_of_fit: float = 0.0
    axis: str = ""
    formula: str = ""
    nominal: float | None = None

    @property
    def deviation(self) -> float | None:
        """Standard error combined with lack of fit; None without a standard error."""
        return None if self.stderr is None else math.hypot(self.stderr, self.lack_of_fit)

    @property
    def interval(self) -> tuple[float, float] | None:
        """Ends of the 2-sigma interval; None without a standard error."""
        deviation = self.deviation
        if self.value is None or deviation is None:
            return None
        return self.value - INTERVAL * deviation, self.value + INTERVAL * deviation

    def __str__(self) -> str:
        """Return the value with its interval; of a refused one its bound."""
        if self.value is None:
            return "not identifiable" if self.lower_bound is None else f"> {number(self.lower_bound, 3)}"
        if self.at_bound is not None or not self.free:
            return f"{number(self.value)} (fixed)" if self.at_bound is None else f"{number(self.at_bound)} (bound)"
        return number(self.value) if self.deviation is None else interval(self.value, INTERVAL * self.deviation)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Accuracy of the reproduced torque, and the effort of the search.

    Attributes:
        measured, predicted: (samples,) raw torque, and that of the model; of several records one after the other; empty
            for a log that is too long for memory; of a robot (samples, n), in the order of its joints.
        relative_error: ``||measured - predicted|| / ||measured||`` of the raw torque, the filter's borders left out.
        filtered_error: the same of the filtered and decimated torque, which was minimised.
        rows: filtered samples that were fitted.
        simulations: of the search, with or without derivatives.
        stop: why the search ended, in a sentence; converged: whether that is a good end.
        conditioning: of a regressor, by name, see `conditioning`; None without a linear regression.
        passes: over the whole of a long log.
        axis_errors: the filtered error of each joint of a robot, by name; its rms is then `filtered_error`.
        nominal_errors: the same of the nominal robot, with the friction of the estimate, by IDIM with fitted friction;
            infinite if it cannot be simulated.
    """

    measured: FloatArray
    predicted: FloatArray
    relative_error: float
    filtered_error: float
    rows: int
    simulations: int
    stop: str
    converged: bool
    conditioning: Mapping[str, float] | None = None
    passes: int = 0
    axis_errors: Mapping[str, float] = field(default_factory=dict)
    nominal_errors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Windows:
    """The windows in which a long log was identified.

    Attributes:
        count: that were fitted; still: in which nothing was asked of the axis, and which were left out.
        length: seconds of each. settling: seconds simulated before and after each window, and not fitted.
        duration: seconds from the first to the last fitted row.
    """

    count: int
    still: int
    length: float
    settling: float
    duration: float


IN_WINDOWS = (
    "The estimate is of a record in windows, whose torque it does not keep; identify a part of the record, by "
    "record.start and record.stop."
)


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """The record, or records, that were identified from.

    Attributes:
        record: its name; of several, all names.
        channels: that were read.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V.
        fingerprints: of the torque of each record or log of a robot, see `fingerprint`; of files of the first window.
        resampled: resampling of the samples to a uniform clock; None if they were logged so.
        windows: how a long log was cut; None for a record.
    """

    record: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    fingerprints: tuple[str, ...] = ()
    resampled: Resampled | None = None
    windows: Windows | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """The model and the method, defaults filled in.

    Attributes:
        method: its name, as in a joint file; variant: how it was run, in words.
        system: the model, a joint or a robot. loop: the closed loop of a joint, when the method simulated one.
        filtering: as used.
        delay: seconds from the logged torque to the acting torque, as declared, or as identified if it was free.
        log_delay: of a robot along its motion, delay of the logged torques, s; None otherwise.
        timing: reading of a torque of unstated timing; None if it was stated, or nothing else tried.
        controller: fingerprint of the law of the identification, for an estimate from a file.
    """

    in_json = "-loop -controller"
    method: str
    variant: str
    system: Joint | Robot
    loop: ClosedLoop | None
    filtering: Filtering
    delay: float = 0.0
    log_delay: float | None = None
    timing: Timing | None = None
    controller: str = ""

    @property
    def simulates(self) -> str:
        """The `Method.simulates` of the method."""
        return method_of(self.method).simulates

    @property
    def joint(self) -> Joint:
        """The model of a joint.

        Raises:
            MethodError: the estimate is of a robot.
        """
        if isinstance(self.system, Robot):
            raise MethodError("This needs the estimate of one joint, and received that of a robot; identify the joint.")
        return self.system


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Documented):
    """The result of an identification.

    The fields after `robot` are for the checks only: `identify` returns an estimate without them.

    Attributes:
        rows: the parameters, in the order of the model, then of its surroundings; ``name@2`` is the second record's.
        correlation: of the errors of the free parameters, all of them, or the joint's, which come first; empty if
            unknown.
        fit: measured and predicted torque, errors, and how the search went.
        data: the record or records.
        settings: the model and the method, defaults filled in.
        checks: answers to the questions that were tested, one or more statements each.
        known: which parameters and combinations the record determines, and how well; None if not computed.
        bounds: lower bounds of a refused stiffness, by the load's share of the inertia.
        agreement: whether several records, each by itself, agree, or the segments of a long log.
        warnings: one sentence each.
        notes: on how the intervals were obtained, one sentence each.
        diagnosis: of loop, log and residual, axis by axis, a `Diagnosis`; None if it was not made.
        robot: the identified robot as it is simulated; None for a joint.
        problem, x: the closed loop that was simulated, and its free parameters; None for other methods. An estimate
            without checks keeps x.
        records: the one record of a joint, or those of a robot's joints; else none.
        solved: fit of a robot that was simulated along one log; None otherwise.
        shifts: (free,) each, by which the deviations of a joint's simulation were widened.
        window: of a log in windows the fit of the one that the search began with, which is checked.
    """

    in_json = (
        "answer parameters correlation controller_sha256 -rows -diagnosis -robot -problem -records -solved -window"
    )
    rows: tuple[EstimatedParameter, ...]
    correlation: FloatArray
    fit: Fit
    data: Data
    settings: Settings
    checks: tuple[Check, ...] = ()
    known: Identifiability | None = None
    bounds: tuple[StiffnessBound, ...] = ()
    agreement: Agreement | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    diagnosis: Documented | None = None
    robot: IdentifiedRobot | None = None
    problem: ClosedLoopProblem | None = None
    x: FloatArray | None = None
    records: tuple[Record, ...] = ()
    solved: RobotFit | None = None
    shifts: tuple[FloatArray, ...] = ()
    window: Estimate | None = None

    @property
    def answer(self) -> Answer:
        """Value, 2-sigma interval, unit and trust, in a line; see `Answer`."""
        return answer_of(self)

    @property
    def sentence(self) -> str:
        """The answer as a line."""
        return str(self.answer)

    @property
    def parameters(self) -> dict[str, EstimatedParameter]:
        """Every parameter by name, ``name@2`` the second record's own."""
        return {row.name: row for row in self.rows}

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Parameter by name or symbol; ``name@2`` is the second record's own.

        Raises:
            MethodError: there is none of this name.
        """
        named = {row.symbol: row for row in self.rows} | self.parameters
        if name not in named:
            there = ", ".join(self.parameters)
            raise MethodError(f'"{name}" is no parameter of this estimate; it has {there}: name one of them.')
        return named[name]

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters that were identified, in the order of `correlation`."""
        return tuple(row.name for row in self.rows if row.free)

    def covariance_of(self, names: Sequence[str]) -> Covariance:
        """Known covariance of the errors of some parameters, (names, names).

        A fixed or refused parameter has no deviation, and one of unknown correlation none with others.
        """
        rows, free, correlation = self.parameters, self.free[: len(self.correlation)], np.eye(len(names))
        known = [i for i, name in enumerate(names) if name in free]
        at = [free.index(names[i]) for i in known]
        correlation[np.ix_(known, known)] = self.correlation[np.ix_(at, at)]
        return Covariance(np.array([rows[name].stderr or 0.0 for name in names]), correlation)

    def about(self, name: Subject) -> tuple[Check, ...]:
        """Statements on a question, the foremost first; none if not asked."""
        return tuple(check for check in self.checks if check.name == name)

    @property
    def controller_sha256(self) -> str:
        """Fingerprint of the loop's controller, see `law_fingerprint`; empty without one."""
        loop = self.settings.loop
        return self.settings.controller or ("" if loop is None else law_fingerprint(loop))

    @property
    def residual(self) -> FloatArray:
        """Measured less predicted raw torque, (samples,); empty for a long log."""
        return self.fit.measured - self.fit.predicted

    @property
    def signal(self) -> str:
        """Name of the compared signal, such as torque computed from position."""
        return f"torque{' computed from the position' if self.about(Subject.SCALE) else ''}"

    @property
    def motion_measured(self) -> bool:
        """True if the motion is assumed exact (drive side, IDIM without "iv")."""
        simulates = self.settings.simulates
        return simulates == "motion" or not (simulates or self.fit.simulations)

    @property
    def values(self) -> dict[str, float]:
        """The joint's parameters by name, fixed ones included, without refused ones."""
        return {p.name: p.value for p in self.rows if p.of_joint and p.value is not None}

    @property
    def frequencies(self) -> dict[str, float]:
        """Frequencies of a flexible joint, Hz, see `FlexibleJoint.frequencies`; none at bounds."""
        found = [p for p in self.rows if p.name in ("motor_inertia", "load_inertia", "stiffness")]
        known = len(found) == 3 and all((p.value or 0.0) > 0 and p.at_bound is None for p in found)
        return FlexibleJoint.frequencies(self.values) if known else {}

    def __repr__(self) -> str:
        """Return model, method and answer: one line, or two."""
        of = "robot" if self.robot is not None else f"{self.settings.joint.model} joint"
        return f"<Estimate of a {of} by {self.settings.method}: {self.answer}>"

    def require_robot(self) -> IdentifiedRobot:
        """Return the robot that was identified.

        Raises:
            MethodError: the estimate is of a joint.
        """
        if self.robot is None:
            raise MethodError("This needs the estimate of a robot, and received that of a joint; identify a robot.")
        return self.robot

    def warn(self, *said: str) -> Estimate:
        """Return the estimate with further warnings."""
        return replace(self, warnings=(*self.warnings, *said))

    def require_values(self) -> dict[str, float]:
        """Return every parameter of the joint by name.

        Raises:
            MethodError: a value is refused, or records have their own, so that no torque can be predicted.
        """
        if refused := [p.name for p in self.rows if p.of_joint and p.value is None]:
            remedy = "identify the joint as rigid" if "stiffness" in refused else "fix one of them"
            said = f"{', '.join(refused)} cannot be determined from this record, so this estimate predicts no torque"
            raise MethodError(f"{said}; {remedy}.")
        if own := [p.name for p in self.rows if p.of_joint and p.name.partition("@")[0] not in self.values]:
            raise MethodError(f"An estimate with {', '.join(own)} predicts no single record; identify one alone.")
        return self.values

    def torque(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> FloatArray:
        """Torque of a motion, as for a feed-forward, N m or N.

        Springs do not deflect in this motion: motor and load move alike. The torque has the log's side and unit.

        Args:
            q: (samples,) position of a joint, or (samples, n) of the joints of a robot, rad or m, on the side that was
                identified; without samples, a number or (n,).
            v: the velocity, in the same shape.
            a: the acceleration, in the same shape.

        Returns:
            The torque, in the shape of the position.

        Raises:
            MethodError: a value is refused, the three have not one shape, or a friction is not linear in its
                parameters.

        Example:
            >>> import jointid as ji
            >>> axis = ji.twin("L19", noise="none")
            >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), axis.loop.controller)
            >>> estimate = ji.identify(axis.record, loop, filtering=ji.Filtering(cutoff=5.0), checks=False)
            >>> values, torque = estimate.values, estimate.torque(0.1, 0.2, 3.0)
            >>> sums = 3.0 * values["inertia"] + 0.2 * values["viscous"] + values["coulomb"] + values["offset"]
            >>> bool(abs(torque - sums) < 1e-9)
            True
        """
        self.require_values()
        motion = [np.asarray(one, dtype=np.float64) for one in (q, v, a)]
        axes: tuple[int, ...] = () if self.robot is None else (len(self.robot.model),)
        shape = motion[0].shape
        if {one.shape for one in motion} != {shape} or shape not in (axes, (*shape[:1], *axes)):
            expected = "(samples,)" if self.robot is None else f"(samples, {axes[0]}) or ({axes[0]},)"
            received = ", ".join(str(one.shape) for one in motion)
            raise MethodError(f"Position, velocity and acceleration have one shape, {expected}; received {received}.")
        rows = [one.reshape(-1, *axes) for one in motion]
        if self.robot is not None:
            kept = [self.robot.names.index(name) for name in self.values]
            columns = self.robot.regressor(*rows)[:, :, kept]
        else:
            moved, joint = Motion(*rows), self.settings.joint
            columns = joint.regressor(moved, moved).sum(axis=0)
        return np.asarray(columns @ np.array([*self.values.values()])).reshape(shape)

    def to_document(self, *, details: bool = False) -> Document:
        """The estimate as a document, with all checks, effort and settings on demand; see `describe_estimate`."""
        from jointid.estimation.result.summary import describe_estimate

        return describe_estimate(self, details=details)

    # What follows is a shorter way to public functions, which stand above this room and are found by their public
    # names, as in a user's program.

    def to_dict(self) -> dict[str, Any]:
        """The estimate as JSON of `jointid identify --json`, see docs/answers.md."""
        import jointid

        return jointid.to_dict(self)

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON, which other commands read; return the path.

        Raises:
            RecordError: the file cannot be written.
        """
        write_whole(path, dumps(self.to_dict()))
        return Path(path)

    @property
    def plot(self) -> jointid.figures.Plots:
        """The figures: ``estimate.plot()``, ``.plot.residual(record)``, ``.spectrum()``, ``.response()`` and more."""
        import jointid

        return jointid.figures.Plots(self)


def fingerprint(torque: FloatArray) -> str:
    """SHA-256 of a torque's samples, which identifies a record."""
    return hashlib.sha256(np.ascontiguousarray(torque).data).hexdigest()


def law_fingerprint(loop: ClosedLoop) -> str:
    """SHA-256 of a loop's controller at a fixed period, identifying its law."""
    slow = getattr(loop.controller, "position_period", None)  # a whole number of times as long, within bounds
    law = loop.controller.law(slow / min(max(round(slow / _PERIOD), 1), 64) if slow else _PERIOD)
    parts = (law.A, law.B, law.C, law.D, law.E, law.F, law.limits, np.array([law.period, law.delay]))
    return fingerprint(np.concatenate([np.ravel(part) for part in parts]))


def relative_error(measured: FloatArray, predicted: FloatArray, borders: tuple[int, int]) -> float:
    """``||measured - predicted|| / ||measured||`` inside the borders; NaN without samples."""
    if not measured.size:
        return math.nan
    if sum(borders) >= measured.size:
        raise RecordError(
            f"Borders of {borders[0]} and {borders[1]} samples leave nothing of a record of {measured.size}; give "
            "smaller borders, or a longer record."
        )
    inside = slice(borders[0], measured.size - borders[1])
    return float(np.linalg.norm((measured - predicted)[inside]) / np.linalg.norm(measured[inside]))


# How it is built


def rows_of_problem(
    problem: ClosedLoopProblem, x: FloatArray, covariance: Covariance, error: FloatArray, J: FloatArray
) -> tuple[EstimatedParameter, ...]:
    """Rows of a problem's solution x, (free,), for joint and surroundings.

    A non-finite deviation is unknown. Residual and derivatives at x determine which bounds are reached.
    """
    own, held = {p.name for p in problem.joint.parameters}, find_active_bounds(problem.free, x, error, J)
    std = {p.name: float(one) for p, one in zip(problem.free, covariance.std, strict=False) if np.isfinite(one)}
    return build_rows(problem.parameters, problem.values(x), std, problem.joint.unit, own, held)


def build_rows(
    parameters: Iterable[Parameter],
    values: Mapping[str, float],
    std: Mapping[str, float],
    unit: Callable[[Parameter], str],
    of_joint: Collection[str],
    held: Mapping[str, float],
) -> tuple[EstimatedParameter, ...]:
    """Rows of parameters, from values, deviations and active bounds by name.

    The names in `of_joint` belong to the joint, and not to its surroundings.
    """
    return tuple(
        EstimatedParameter(
            p.name, p.symbol, unit(p), values[p.name], std.get(p.name) if p.free else None, p.free,
            of_joint=p.name.partition("@")[0] in of_joint, at_bound=held.get(p.name),
        )
        for p in parameters
    )  # fmt: skip


def build_estimate(
    records: Sequence[Record],
    rows: tuple[EstimatedParameter, ...],
    correlation: FloatArray,
    torques: tuple[FloatArray, FloatArray],
    error: float | FloatArray,
    fitted: int,
    end: tuple[str, bool],
    simulations: int,
    settings: Settings,
    channels: Collection[str] = (),
    *,
    robot: IdentifiedRobot | None = None,
    nominal: FloatArray | None = None,
    warnings: Sequence[str] = (),
    **found: Any,
) -> Estimate:
    """Build the estimate of a joint or robot from a method's results.

    Args:
        records: that were read; of a robot those of its joints, one log after the other.
        rows: the parameters.
        correlation: of the errors of the free ones, in their order.
        torques: (samples, n) each, measured and predicted; of a joint n is 1, or they are (samples,).
        error: residual share of the filtered torque; of a robot (n,).
        fitted: rows of the filtered torque.
        end: why the search ended, and whether that is a good end.
        simulations: of the search.
        settings: model and method.
        channels: that were read; without them those of the loop, or else all of the records'.
        robot: that was identified; None for a joint.
        nominal: (n,) residual share of each joint's filtered torque for the nominal robot.
        warnings: of the method.
        found: further parts of the estimate.
    """
    measured, predicted = torques if robot is not None else (one.reshape(-1) for one in torques)
    borders = settings.filtering.borders
    read = [record.torque for record in records if record.torque is not None]
    errors, names = np.atleast_1d(error), () if robot is None else robot.model.names
    logs = [read[at : at + errors.size] for at in range(0, len(read), errors.size)]
    by_axis = dict(zip(names, map(float, errors), strict=False))
    counts = [one.counts(len(one.torque), one.torque.sample_time) for one in records[:: errors.size] if one.torque]
    counted = np.concatenate(counts)[: len(measured)]
    nominals = () if robot is None or nominal is None or not robot.model.has_masses else map(float, nominal)
    if settings.loop is not None:
        injected = ["injected" for record in records if record.injected is not None]
        channels = (*(channels or settings.loop.channels), *injected)
    fit = Fit(
        measured, predicted, relative_error((measured.T * counted).T, (predicted.T * counted).T, borders),
        float(np.sqrt(np.mean(errors**2))) if by_axis else float(errors[0]), fitted, simulations, *end,
        axis_errors=by_axis, nominal_errors=dict(zip(names, nominals, strict=False)),
    )  # fmt: skip
    warnings = (*(() if robot is None else robot.model.remarks), *warnings)
    data = Data(
        record=join(list(dict.fromkeys(record.name for record in records))),
        channels=tuple(dict.fromkeys(channels or (name for record in records for name in record.channels))),
        sample_time=read[0].sample_time,
        torque_unit=join(list(dict.fromkeys(torque.unit for torque in read))),
        fingerprints=tuple(fingerprint(np.concatenate([torque.values for torque in log])) for log in logs),
        resampled=records[0].resampled if len(records) == 1 else None,
    )
    kept: dict[str, Any] = {"warnings": tuple(warnings), "records": () if robot is None else tuple(records)}
    return Estimate(rows, correlation, fit, data, settings, robot=robot, **kept, **found)


def warn_of_limit(share: float) -> tuple[str, ...]:
    """Warning of a controller at its limit in more than few periods."""
    if share <= 0.01:  # of the periods of a controller: more is said
        return ()
    said = f"the controller is at its limit in {100 * share:.1f} % of the periods"
    return (f"{said}, where the torque says nothing of the joint",)
