"""The estimate: what `identify` returns, complete and frozen, of a joint as of a robot."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented
from jointid.common.errors import MethodError, RecordError
from jointid.estimation.result.agreement import Agreement
from jointid.estimation.result.answer import Answer, answer_of
from jointid.estimation.result.fields import write
from jointid.estimation.result.parts import Data, EstimatedParameter, Fit, Settings
from jointid.estimation.result.verdict import Check, StiffnessBound, Subject
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.position_forces import Motion
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.identifiability import Identifiability

if TYPE_CHECKING:
    import jointid
    from jointid.estimation.problems.closed_loop import ClosedLoopProblem
    from jointid.estimation.robots.didim import RobotFit
    from jointid.estimation.robots.simulated import IdentifiedRobot
    from jointid.records.record import Record

_PERIOD = 1e-4  # s, at which two controllers without one of their own are compared
_MOST = 64  # times that a position loop may be slower


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Estimate(Documented):
    """The result of an identification.

    What follows `robot` is kept for the checks alone: `identify` returns an estimate without it.

    Attributes:
        rows: the parameters, in the order of the model, then of what surrounds it; ``name@2`` is the second record's.
        correlation: of the errors of the free parameters, all of them, or the joint's, which come first; empty where it
            is not known.
        fit: measured and predicted torque, errors, and how the search went.
        data: the record or records.
        settings: the model and the method, defaults filled in.
        checks: answers to the questions that were asked of it, one or more statements each.
        known: which parameters and combinations the record determines, and how well; None where it was not asked.
        bounds: lower bounds of a refused stiffness, by the load's share of the inertia.
        agreement: whether several records, each by itself, agree, or the segments of a long log.
        warnings: one sentence each.
        notes: on how the intervals were obtained, one sentence each.
        diagnosis: of loop, log and residual, axis by axis, a `Diagnosis`; None where it was not made.
        robot: of a robot what was identified as it is simulated; None for a joint.
        problem, x: the closed loop that was simulated, and its free parameters; None for other methods.
        records: the one record of a joint, or those of a robot's joints; else none.
        solved: of a robot that was simulated along one log; None elsewhere.
        undetermined: names of parameters that lose their values once all is checked.
        shifts: (free,) each, by which the deviations of a joint's simulation were widened.
        window: of a log in windows the fit of the one that the search began with, which is checked.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> estimate = ji.identify(ji.simulated_record(loop, reference, truth, sample_time=1e-3), loop)
        >>> round(estimate["inertia"].value, 6), estimate.fit.converged
        (30.0, True)
    """

    in_json = (
        "answer parameters correlation controller_sha256 "
        "-rows -diagnosis -robot -problem -records -solved -undetermined -window"
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
    undetermined: tuple[str, ...] = ()
    shifts: tuple[FloatArray, ...] = ()
    window: Estimate | None = None

    @property
    def answer(self) -> Answer:
        """The first line: value, 2-sigma interval and unit, and whether to rely on it; see `Answer`."""
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
        """Return a parameter by its name or symbol; ``name@2`` is the second record's own.

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
        """Return the covariance of the errors of some parameters, (names, names), as far as it is known.

        A parameter that is fixed or refused has no deviation, and one of unknown correlation none with others.
        """
        rows, free, correlation = self.parameters, self.free[: len(self.correlation)], np.eye(len(names))
        known = [i for i, name in enumerate(names) if name in free]
        at = [free.index(names[i]) for i in known]
        correlation[np.ix_(known, known)] = self.correlation[np.ix_(at, at)]
        return Covariance(np.array([rows[name].stderr or 0.0 for name in names]), correlation)

    def about(self, name: Subject) -> tuple[Check, ...]:
        """Return the statements that answer a question, the foremost first; none where it was not asked."""
        return tuple(check for check in self.checks if check.name == name)

    @property
    def controller_sha256(self) -> str:
        """Fingerprint of the loop's controller, see `law_fingerprint`; empty without one."""
        loop = self.settings.loop
        return self.settings.controller or ("" if loop is None else law_fingerprint(loop))

    @property
    def residual(self) -> FloatArray:
        """Measured less predicted torque, raw, (samples,); empty for a log that is too long for memory."""
        return self.fit.measured - self.fit.predicted

    @property
    def signal(self) -> str:
        """The name of the signal that the fit compares, such as a torque computed from the position."""
        return f"torque{' computed from the position' if self.about(Subject.SCALE) else ''}"

    @property
    def motion_measured(self) -> bool:
        """True if the measured motion is taken as free of the error: on the drive side, and by IDIM without "iv"."""
        method = self.settings.method
        return method == "drive_side" or (method == "idim" and self.fit.simulations == 0)

    @property
    def values(self) -> dict[str, float]:
        """The parameters of the joint by name, fixed ones included; a refused one is missing."""
        return {p.name: p.value for p in self.rows if p.of_joint and p.value is not None}

    @property
    def frequencies(self) -> dict[str, float]:
        """Frequencies of a flexible joint, Hz, as `FlexibleJoint.frequencies` names them; none at a bound."""
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
        """Return the torque of a motion, as for a feed-forward, N m or N, as the log has it.

        A spring does not deflect in this motion, so that motor and load move alike.

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
        """Return the estimate as a document: table, combinations, errors, verdicts that did not pass, and warnings.

        Args:
            details: whether to add the verdicts that passed, all reasons, tests, effort and settings.
        """
        from jointid.estimation.result.summary import describe_estimate

        return describe_estimate(self, details=details)

    # What follows is a shorter way to public functions, which stand above this room and are found by their public
    # names, as in a user's program.

    def to_dict(self) -> dict[str, Any]:
        """Return the estimate as JSON has it: what `jointid identify --json` writes, see docs/answers.md."""
        import jointid

        return jointid.to_dict(self)

    def save(self, path: str | Path) -> Path:
        """Write `to_dict` as JSON, which other commands read; return the path.

        Raises:
            RecordError: the file cannot be written.
        """
        write(self.to_dict(), path)
        return Path(path)

    @property
    def plot(self) -> jointid.figures.Plots:
        """The figures: ``estimate.plot()``, ``.plot.residual(record)``, ``.spectrum()``, ``.response()`` and more."""
        import jointid

        return jointid.figures.Plots(self)


def fingerprint(torque: FloatArray) -> str:
    """Return the SHA-256 of a torque's samples: two records with the same one are the same record."""
    return hashlib.sha256(np.ascontiguousarray(torque).tobytes()).hexdigest()


def law_fingerprint(loop: ClosedLoop) -> str:
    """Return the SHA-256 of a loop's controller at a fixed period: two loops with the same one have the same law."""
    slow = getattr(loop.controller, "position_period", None)  # a whole number of times as long, within bounds
    law = loop.controller.law(slow / min(max(round(slow / _PERIOD), 1), _MOST) if slow else _PERIOD)
    digest = hashlib.sha256()
    for array in (law.A, law.B, law.C, law.D, law.E, law.F, law.limits, np.array([law.period, law.delay])):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def relative_error(measured: FloatArray, predicted: FloatArray, borders: tuple[int, int]) -> float:
    """Return ``||measured - predicted|| / ||measured||`` with samples left out at both ends; NaN without samples."""
    if not measured.size:
        return math.nan
    if sum(borders) >= measured.size:
        raise RecordError(
            f"Borders of {borders[0]} and {borders[1]} samples leave nothing of a record of {measured.size}; give "
            "smaller borders, or a longer record."
        )
    inside = slice(borders[0], measured.size - borders[1])
    return float(np.linalg.norm((measured - predicted)[inside]) / np.linalg.norm(measured[inside]))
