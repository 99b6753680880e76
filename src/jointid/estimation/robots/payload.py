"""A payload, from a record with it and one without: mass, centre and inertia of what the last link carries.

By IDIM both records are one regression: base parameters and friction are the same in both, and the payload's ten
parameters act in the second alone. So all are identifiable, though those of the last link are not [Khalil, Gautier and
Lemoine 2007]. The difference of two estimates gives the same payload with a wider interval.

By DIDIM, and on the drive side of a flexible robot, the payload comes from two estimates. With the same friction in
both, that is the fit of both records at once, by the covariance of each; otherwise it is the difference.

Both ways read the same records, so their agreement says that the robot was the same in both: its friction and its own
links. Where they differ by more than three deviations of the difference alone, one of these has changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.text import interval, join, number
from jointid.estimation.identify import fit_robot
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.methods.linear import Rows, solve_rows
from jointid.estimation.methods.prescribed import DriveSideFit
from jointid.estimation.methods.registry import Method
from jointid.estimation.result.parts import EstimateParts
from jointid.estimation.result.robot import KNOWN
from jointid.estimation.robots.idim import InverseModelRobot
from jointid.estimation.robots.numbers import RobotParameters, robot_parameters
from jointid.estimation.robots.regression import (
    base_rows,
    join_rows,
    motions_of_logs,
    require_slow_samples,
    robot_record_warnings,
)
from jointid.estimation.robots.simulated import SimulatedRobot
from jointid.estimation.unknown_timing import cover_both_readings, read_as_identified
from jointid.models.robots.base_parameters import base_parameters, inverse_columns
from jointid.models.robots.friction_terms import offset_indices
from jointid.models.robots.inertial import SYMBOLS, is_physical, mass_properties
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.robot_drive_side import RobotDriveSide
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.covariance import Covariance, covariance_of

_STEP = 1e-6  # of a difference, relative
_TOGETHER = 1e-8  # of the largest: a direction in which a payload's ten parameters change nothing
_ROWS = (
    *(("mass", "kg"), ("centre x", "m"), ("centre y", "m"), ("centre z", "m")),
    *((f"inertia {axes}", "kg m2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
_TWO = 2.0  # standard deviations of an interval
_FAR = 3.0  # deviations between the two ways, of ten numbers the largest


@dataclass(frozen=True, slots=True, eq=False)
class PayloadParameters:
    """Inertial parameters of a payload, in the frame of the link that carries it.

    Attributes:
        link: its name.
        inertial: (10,) the payload's inertial parameters.
        covariance: of these.
    """

    link: str
    inertial: FloatArray
    covariance: Covariance

    @property
    def properties(self) -> tuple[FloatArray, FloatArray]:
        """Mass, centre (3) and inertia at the centre (xx, yy, zz, xy, xz, yz), (10,), and their deviations, (10,)."""
        values = _convert(self.inertial)
        steps = _STEP * np.maximum(np.abs(self.inertial), self.covariance.std)
        slopes = np.array(
            [(_convert(self.inertial + d) - _convert(self.inertial - d)) / (2 * d.max()) for d in np.diag(steps)]
        ).T
        return values, np.sqrt(np.maximum(np.diag(slopes @ self.covariance.matrix @ slopes.T), 0.0))


def _convert(inertial: FloatArray) -> FloatArray:
    body = mass_properties(inertial)
    return np.array([body.mass, *body.centre, *body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])


@dataclass(frozen=True, slots=True, eq=False)
class Payload(Documented):
    """A payload by both records at once, and by the difference of an estimate of each.

    Attributes:
        payload: by both records at once, which is the answer; on the drive side by the difference, too.
        difference: by two estimates.
        warnings: of the estimates and on their records, one sentence each.
    """

    in_json = "link rows agrees possible -payload -difference"
    payload: PayloadParameters
    difference: PayloadParameters
    warnings: tuple[str, ...] = ()

    @property
    def link(self) -> str:
        """Link that carries it."""
        return self.payload.link

    @property
    def rows(self) -> Mapping[str, Mapping[str, float | str]]:
        """Value, deviation, unit and verdict of each number, and the same by difference."""
        values, std = self.payload.properties
        others, spread = self.difference.properties
        found: dict[str, Mapping[str, float | str]] = {}
        for k, (name, unit) in enumerate(_ROWS):
            found[name] = {
                "value": float(values[k]), "std": float(std[k]), "unit": unit,
                "verdict": _verdict(name, float(values[k]), float(std[k])),
                "by_difference": float(others[k]), "by_difference_std": float(spread[k]),
            }  # fmt: skip
        return found

    @property
    def apart(self) -> FloatArray:
        """How far the two ways are apart, in deviations of the difference, (10,)."""
        (values, _), (others, spread) = self.payload.properties, self.difference.properties
        return np.asarray((values - others) / np.maximum(spread, 1e-300))

    @property
    def agrees(self) -> bool:
        """True if both ways say the same."""
        return bool(np.max(np.abs(self.apart)) <= _FAR)

    @property
    def possible(self) -> bool:
        """True if a body can have the ten parameters as they were found."""
        return is_physical(self.payload.inertial)

    @property
    def sentence(self) -> str:
        """The mass and the centre."""
        mass, *centre = list(self.rows.values())[:4]
        at = ", ".join(number(float(one["value"]), 3) for one in centre)
        weight = interval(float(mass["value"]), _TWO * float(mass["std"]))
        return f"The payload weighs {weight} kg, 2 sigma, with its centre at ({at}) m of {self.link}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the verdict first, then each number both ways; there are no further details."""
        del details
        rows, said = self.rows, list[str]()
        lines = [
            (
                name,
                interval(float(row["value"]), _TWO * float(row["std"])),
                str(row["unit"]),
                str(row["verdict"]),
                interval(float(row["by_difference"]), _TWO * float(row["by_difference_std"])),
            )
            for name, row in rows.items()
        ]
        if self.payload is self.difference:
            said.append("It is the difference of two estimates, each with its own friction.")
        elif self.agrees:
            said.append("The difference of two estimates says the same.")
        else:
            far = [name for name, one in zip(rows, self.apart, strict=True) if abs(one) > _FAR]
            said.append(
                f"The difference of two estimates, each with its own friction, says otherwise of {join(far)}: "
                "something beside the payload changed between the records, as friction does that warms up. Believe the "
                "difference."
            )
        if not self.possible:
            said.append("No body has just these numbers; those that are not known may be far off.")
        header = ("", "both records, 2 sigma", "unit", "verdict", "by difference, 2 sigma")
        return Document(
            self.sentence,
            (
                Paragraph(" ".join(said), lead=True, tone="good" if self.agrees else "bad"),
                Table(header, tuple(lines), f"in the frame of {self.link}; inertia at the centre", (0, 1, 2, 3)),
                *_list_warnings(self.warnings),
            ),
        )


def _list_warnings(warnings: Sequence[str]) -> tuple[Facts, ...]:
    return (Facts(tuple(("warning", said) for said in warnings)),) if warnings else ()


def _verdict(name: str, value: float, std: float) -> str:
    """Return whether a number is known; a centre that is at 0 may be known, too, so there is only its interval."""
    if name.startswith("centre"):
        return f"within {1e3 * _TWO * std:.2g} mm"
    if std <= KNOWN * abs(value):
        return "known"
    return "roughly known" if _TWO * std < abs(value) else "not significant"


def _refuse_payloads(*given: Sequence[Record] | EstimateParts) -> None:
    """Refuse records with a known payload: what is identified would be what is carried beside it."""
    for log in given:
        if not isinstance(log, EstimateParts) and any(record.payload for record in log):
            raise MethodError(
                "A record states its payload, which is to be identified here; leave payload_mass of [[records]], or "
                "Record.payload, out."
            )


@one_thread()
def identify_payload(
    model: Robot | RobotLoop | RobotDriveSide,
    empty: Sequence[Record] | EstimateParts,
    loaded: Sequence[Record],
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> Payload:
    """Identify what the last link carries in the second record and not in the first, in two ways.

    Args:
        model: the robot's geometry, gravity and coupling for IDIM; the robot under its controllers, whose gains are the
            same with the payload, for DIDIM; or a flexible robot on the drive side.
        empty: the record of each joint without the payload, or the robot's estimate by the same method; by IDIM an
            estimate leaves the difference of two estimates alone.
        loaded: the record of each joint with it; another motion will do.
        method: as of `jointid.identify`.
        filtering: of positions, torques and rows.
        progress: receives the steps.

    Raises:
        MethodError: the records or the robot do not determine the payload, its mass comes out negative, the method does
            not fit the model, does not settle or is not that of the estimate, or the estimator is "iv".
        RecordError: as of `jointid.identify`.
    """
    if not isinstance(model, Robot | RobotLoop | RobotDriveSide):
        raise MethodError(
            "A payload is identified with a Robot, a RobotLoop or a RobotDriveSide; of a joint, compare two estimates."
        )
    if method is not None:
        method.require_settings_of("robot")
    _refuse_payloads(empty, loaded)
    robot = model if isinstance(model, Robot) else model.robot
    by_rows = isinstance(method, IDIM) or (method is None and isinstance(model, Robot))
    name = "idim" if by_rows else "drive_side" if isinstance(model, RobotDriveSide) else "didim"
    if isinstance(empty, EstimateParts) and empty.settings.method != name:
        raise MethodError(
            f"The estimate without the payload is by {empty.settings.method}, and the record with it is identified by "
            f"{name}; expected one method for both: give the record without the payload."
        )
    setup, free, said_of = model, method, dict[str, tuple[str, ...]]()

    def identify(records: Sequence[Record] | EstimateParts, which: str) -> EstimateParts:
        if isinstance(records, EstimateParts):
            return records
        found = fit_robot(records, setup, free, filtering=filtering, progress=progress)
        said_of[which] = (*found.checks.warnings, *robot_record_warnings(records, robot))
        return found

    if by_rows:
        settings = method if isinstance(method, IDIM) else IDIM()
        if settings.estimator == "iv":
            raise MethodError(
                'A payload is identified from two records without a simulation, so the estimator "iv" has no '
                'instruments there; use "weighted" or "ols".'
            )
        setup, free = robot, settings
    else:
        offsets = not isinstance(method, DIDIM | DriveSideFit) or method.offsets
        require_full_payload(payload_columns(robot_parameters(robot, offsets=offsets)))
    first, second = identify(empty, "without the payload"), identify(loaded, "with it")
    if by_rows:
        together = difference = payload_difference(first, second)
        if not isinstance(empty, EstimateParts):
            empty, loaded = (read_as_identified(log, one.settings) for log, one in ((empty, first), (loaded, second)))
            together = payload_of_both_records(robot, empty, loaded, settings, filtering)
    else:
        together = difference = payload_of_torques(first, second, same_friction=False)
        # With one friction for both the centre came out 0.8 % short in seven of seven draws of noise.
        if not isinstance(model, RobotDriveSide):
            together = payload_of_torques(first, second, same_friction=True)
    warnings = (
        text if all(text in each for each in said_of.values()) else f"{which}: {text}"
        for which, texts in said_of.items()
        for text in texts
    )
    return Payload(together, difference, tuple(dict.fromkeys(warnings)))


def payload_of_both_records(
    robot: Robot,
    empty: Sequence[Record],
    loaded: Sequence[Record],
    settings: IDIM | None = None,
    filtering: Filtering | None = None,
) -> PayloadParameters:
    """Fit the payload to both records in one regression.

    Args:
        robot: its geometry, gravity and coupling.
        empty: the record of each joint without the payload.
        loaded: the record of each joint with it.
        settings: of the regression.
        filtering: of positions and rows.

    Raises:
        MethodError: the records do not determine it, its mass comes out negative, or the estimator is "iv".
        RecordError: as of `identify_robot`.

    Where the torques' timing is not stated, the intervals cover a torque held and one sampled.
    """
    estimator, own = (settings or IDIM()).estimator or "weighted", slice(-len(SYMBOLS), None)

    def fit(logs: Sequence[Sequence[Record]]) -> tuple[FloatArray, Covariance]:
        solution = solve_rows(both_records(robot, logs, filtering or Filtering()), estimator, {})
        covariance = solution.covariance
        return solution.values[own], covariance_of(covariance.matrix[own, own], covariance.bandwidth)

    return _payload(robot, *cover_both_readings((empty, loaded), fit))


def both_records(robot: Robot, logs: Sequence[Sequence[Record]], filtering: Filtering) -> Rows:
    """Return the regression of both records: base parameters, friction, and the payload's ten in the second alone.

    Args:
        robot: its geometry, gravity and coupling.
        logs: the records of the joints without the payload, and those with it.
        filtering: of positions and rows.

    Raises:
        RecordError, MethodError: as of `identify_robot`.
    """
    base, n = base_parameters(robot), len(robot)
    without, carrying = motions_of_logs(robot, logs, filtering)
    first, second = base_rows(robot, base, without), base_rows(robot, base, carrying)
    require_slow_samples(robot, first)
    columns = inverse_columns(robot, carrying.q, carrying.v, carrying.a)[:, :, 10 * (n - 1) : 10 * n]
    extra = carrying.decimate_columns(columns)
    W = [np.hstack([first.W, np.zeros((len(first.Y), 10))]), np.hstack([second.W, extra])]
    names = (*first.names, *(f"payload {symbol}" for symbol in SYMBOLS))
    return Rows(join_rows([first.Y, second.Y], n), join_rows(W, n), names, n, n)


def payload_difference(empty: EstimateParts, loaded: EstimateParts) -> PayloadParameters:
    """Return the payload that makes one estimate of a robot into the other, by generalised least squares.

    Args:
        empty: without the payload.
        loaded: with it, of the same robot.

    Raises:
        MethodError: the estimates are of two robots, which does not tell all of a payload, or its mass comes out
            negative.
    """
    first, second = empty.require_robot(), loaded.require_robot()
    assert isinstance(first, InverseModelRobot)
    assert isinstance(second, InverseModelRobot)
    if first.names != second.names or not np.allclose(first.base.grouping, second.base.grouping):
        raise MethodError("The estimates are of two robots; expected one, without its payload and with it.")
    if not all(row.free for estimate in (empty, loaded) for row in estimate.params.rows):
        raise MethodError(
            "A parameter is fixed, which a payload would change; expected estimates of all: leave it free."
        )
    robot, base = first.model, first.base
    n, size, of_offsets = len(robot), len(base), np.any(base.offsets, axis=1)
    offsets = size + np.array(offset_indices(robot))[of_offsets]
    read = np.concatenate([np.arange(size), offsets])  # a weight that is a constant torque is an offset's
    columns = np.vstack([base.grouping, base.offsets[of_offsets]])[:, 10 * (n - 1) : 10 * n]
    matrix = (first.covariance.matrix + second.covariance.matrix)[np.ix_(read, read)]
    return _explain_change(robot, columns, (second.values - first.values)[read], matrix)


def payload_of_torques(empty: EstimateParts, loaded: EstimateParts, *, same_friction: bool) -> PayloadParameters:
    """Return the payload that makes one estimate by simulation into the other, by generalised least squares.

    Args:
        empty: without the payload.
        loaded: with it, of the same robot.
        same_friction: whether friction, and the springs' damping, are the same in both; else each has its own.

    Raises:
        MethodError: as of `payload_difference`; an estimate did not settle, or does not show a spring.
    """
    without, carrying = empty.require_robot(), loaded.require_robot()
    assert isinstance(without, SimulatedRobot)
    assert isinstance(carrying, SimulatedRobot)
    first, second = without.parameters, carrying.parameters
    own, others = first.of_robot, second.of_robot
    names = [[name for name, mine in zip(one.names, one.of_robot, strict=True) if mine] for one in (first, second)]
    if names[0] != names[1] or not np.allclose(first.grouping[own], second.grouping[others]):
        raise MethodError("The estimates are of two robots; expected one, without its payload and with it.")
    for estimate, record in ((empty, "without the payload"), (loaded, "with it")):
        if hidden := [one.joint for one in estimate.require_robot().springs if not one.shown]:
            raise MethodError(
                f"The record {record} does not show the spring of {join(hidden)}, so it does not part motor from "
                "link there; expected records that do: leave this spring out of the robot file, or excite its mode."
            )
        if not estimate.fit.converged:
            raise MethodError(
                f"The search did not settle on the record {record}; identify it to see what it leaves, or allow "
                "more by method.iterations, of springs method.evaluations."
            )
    columns = payload_columns(first)[own]
    same = np.array([same_friction or not place.is_friction for place in first.places])[own]
    read = same | np.any(columns, axis=1)
    one, other = without.covariance.matrix[np.ix_(own, own)], carrying.covariance.matrix[np.ix_(others, others)]
    change = carrying.values[others] - without.values[own]
    return _explain_change(without.model, columns[read], change[read], (one + other)[np.ix_(read, read)])


def payload_columns(parameters: RobotParameters) -> FloatArray:
    """Return the derivatives of the parameters by a payload on the last link, (parameters, 10)."""
    columns = np.empty((len(parameters.places), len(SYMBOLS)))
    without = parameters.group(parameters.base)
    for k in range(len(SYMBOLS)):
        inertials = parameters.base.inertials.copy()
        inertials[-1, k] += 1.0
        columns[:, k] = parameters.group(replace(parameters.base, inertials=inertials)) - without
    return columns


def require_full_payload(columns: FloatArray) -> None:
    """Raise if a payload's ten numbers do not change the parameters of a robot in ten ways.

    Args:
        columns: (parameters, 10) what each of them adds to each parameter.

    Raises:
        MethodError: some act on nothing, or only together.
    """
    scaled = columns / column_norms(columns)
    _, sizes, directions = np.linalg.svd(scaled, full_matrices=True)
    hidden = directions[int(np.sum(sizes > _TOGETHER * sizes[0])) :]
    if len(hidden):
        names = [SYMBOLS[k] for k in np.flatnonzero(np.max(np.abs(hidden), axis=0) > 0.2)]
        raise MethodError(
            f"This robot does not tell all of a payload: {join(names)} act on no torque, or only together; expected "
            "joints that turn and tilt the last link about several axes."
        )


def _explain_change(robot: Robot, columns: FloatArray, change: FloatArray, matrix: FloatArray) -> PayloadParameters:
    """Fit a payload to a change of parameters with its covariance."""
    require_full_payload(columns)
    std = np.sqrt(np.diag(matrix))
    std = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(std, std))
    whiten = (vectors / np.sqrt(np.maximum(values, 1e-10 * values[-1]))).T / std
    seen = whiten @ columns
    found = np.linalg.lstsq(seen, whiten @ change, rcond=None)[0]
    return _payload(robot, found, covariance_of(np.linalg.pinv(seen.T @ seen), 0))


def _payload(robot: Robot, inertial: FloatArray, covariance: Covariance) -> PayloadParameters:
    if not inertial[0] > 0:
        raise MethodError(
            f"The payload's mass comes out as {inertial[0]:.3g} kg; expected a positive one: check that the second "
            "record is the one with the payload, and that both have the same torque's unit."
        )
    return PayloadParameters(robot.links[-1].name, inertial, covariance)
