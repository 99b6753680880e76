"""A payload, from a record with it and one without: mass, centre and inertia of what the last link carries.

It is what makes the estimate without it into the estimate with it, by generalised least squares over the sums of
inertial parameters that both know, with the covariance of each. Friction is each estimate's own: it changes as gears
warm up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.text import interval, join, number
from jointid.estimation.identify import fit
from jointid.estimation.methods.registry import Method
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.consistent import require_shown, whitening
from jointid.models.robots.inertial import SYMBOLS, is_physical, mass_properties
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.drive_side import RobotDriveSide
from jointid.uncertainty.covariance import Covariance, covariance_of

_STEP = 1e-6  # of a difference, relative
_TOGETHER = 1e-8  # of the largest: a direction in which a payload's ten parameters change nothing
_ROWS = (
    *(("mass", "kg"), ("centre x", "m"), ("centre y", "m"), ("centre z", "m")),
    *((f"inertia {axes}", "kg m2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
)
_TWO = 2.0  # standard deviations of an interval


@dataclass(frozen=True, slots=True, eq=False)
class Payload(Documented):
    """A payload, in the frame of the link that carries it.

    Attributes:
        link: its name.
        inertial: (10,) the payload's inertial parameters. covariance: of these.
        warnings: of the estimates and on their records, one sentence each.
    """

    in_json = "rows possible -inertial -covariance"
    link: str
    inertial: FloatArray
    covariance: Covariance
    warnings: tuple[str, ...] = ()

    @property
    def properties(self) -> tuple[FloatArray, FloatArray]:
        """Mass, centre (3) and inertia at the centre (xx, yy, zz, xy, xz, yz), (10,), and their deviations, (10,)."""
        values = _convert(self.inertial)
        steps = _STEP * np.maximum(np.abs(self.inertial), self.covariance.std)
        slopes = np.array(
            [(_convert(self.inertial + d) - _convert(self.inertial - d)) / (2 * d.max()) for d in np.diag(steps)]
        ).T
        return values, np.sqrt(np.maximum(np.diag(slopes @ self.covariance.matrix @ slopes.T), 0.0))

    @property
    def rows(self) -> Mapping[str, Mapping[str, float | str]]:
        """Value, deviation and unit of each number."""
        found = zip(_ROWS, *(map(float, one) for one in self.properties), strict=True)
        return {name: {"value": value, "std": std, "unit": unit} for (name, unit), value, std in found}

    @property
    def possible(self) -> bool:
        """True if a body can have the ten parameters as they were found."""
        return is_physical(self.inertial)

    def to_document(self, *, details: bool = False) -> Document:
        """Return the mass and the centre first, then each number; there are no further details."""
        del details
        lines = [
            (name, interval(float(row["value"]), _TWO * float(row["std"])), str(row["unit"]))
            for name, row in self.rows.items()
        ]
        at = ", ".join(number(float(one), 3) for one in self.properties[0][1:4])
        first = f"The payload weighs {lines[0][1]} kg, 2 sigma, with its centre at ({at}) m of {self.link}."
        said = "" if self.possible else "No body has just these numbers; those that are not known may be far off."
        title = f"in the frame of {self.link}; inertia at the centre"
        return Document(
            first,
            (
                *([Paragraph(said, tone="bad")] if said else []),
                Table(("", "value, 2 sigma", "unit"), tuple(lines), title, (0, 1, 2)),
                Facts(tuple(("warning", one) for one in self.warnings)),
            ),
        )


def _convert(inertial: FloatArray) -> FloatArray:
    body = mass_properties(inertial)
    return np.array([body.mass, *body.centre, *body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])


@one_thread()
def identify_payload(
    model: Robot | RobotLoop | RobotDriveSide,
    empty: Sequence[Record] | Estimate,
    loaded: Sequence[Record],
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> Payload:
    """Identify what the last link carries in the second record and not in the first.

    Args:
        model: the robot's geometry, gravity and coupling for IDIM; the robot under its controllers, whose gains are the
            same with the payload, for DIDIM; or a flexible robot on the drive side.
        empty: the record of each joint without the payload, or the robot's estimate by the same method.
        loaded: the record of each joint with it; another motion will do.
        method: as of `jointid.identify`.
        filtering: of positions, torques and rows.
        progress: receives the steps.

    Raises:
        MethodError: see `payload_difference`; or the method does not fit the model.
        RecordError: as of `jointid.identify`.
    """
    each, warnings = list[Estimate](), list[str]()
    for log in (empty, loaded):
        if isinstance(log, Estimate):
            each.append(log)
            continue
        if any(record.payload for record in log):
            raise MethodError(
                "A record states its payload, which is to be identified here; leave payload_mass of [[records]], or "
                "Record.payload, out."
            )
        each.append(fit(log, model, method, filtering=filtering, progress=progress))
        warnings += each[-1].warnings
    return replace(payload_difference(*each), warnings=tuple(dict.fromkeys(warnings)))


def payload_difference(empty: Estimate, loaded: Estimate) -> Payload:
    """Return the payload that makes one estimate of a robot into the other, by generalised least squares.

    Args:
        empty: without the payload.
        loaded: with it, of the same robot by the same method.

    Raises:
        MethodError: the estimates are of two robots or methods, an estimate did not settle or refuses a parameter, the
            robot does not tell all of a payload, or its mass comes out negative.
    """
    each = list[tuple[list[str], FloatArray, FloatArray, FloatArray]]()
    for estimate in (empty, loaded):
        part = estimate.require_robot()
        require_shown(estimate)
        sums = part.parameters.of_standard
        own = np.flatnonzero(np.any(sums, axis=1))  # a weight that is a constant torque is an offset's
        named = [part.names[i] for i in own]
        each.append((named, part.values[own], sums[own], estimate.covariance_of(named).matrix))
    (names, before, columns, noise), (others, after, standard, more) = each
    alike = names == others and np.allclose(columns, standard) and empty.settings.method == loaded.settings.method
    free = alike and np.all(np.diag(noise) * np.diag(more) > 0.0)
    if not free or not (empty.fit.converged and loaded.fit.converged):
        raise MethodError(
            "A payload is the difference of two searches that settled, of one robot by one method, every parameter "
            f"free that a payload changes; these are by {empty.settings.method} and {loaded.settings.method}: identify "
            "each record to see what it leaves, free what is fixed, or allow more by method.evaluations."
        )
    link, last = part.model.links[-1].name, len(SYMBOLS) * (len(part.model) - 1)
    columns = columns[:, last : last + len(SYMBOLS)]
    _, sizes, directions = np.linalg.svd(columns / column_norms(columns), full_matrices=True)
    hidden = directions[int(np.sum(sizes > _TOGETHER * sizes[0])) :]
    if len(hidden):
        lost = [SYMBOLS[k] for k in np.flatnonzero(np.max(np.abs(hidden), axis=0) > 0.2)]
        raise MethodError(
            f"This robot does not tell all of a payload: {join(lost)} act on no torque, or only together; expected "
            "joints that turn and tilt the last link about several axes."
        )
    whiten = whitening(covariance_of(noise + more))
    seen = whiten @ columns
    spread = np.asarray(np.linalg.pinv(seen.T @ seen), dtype=np.float64)
    inertial = spread @ seen.T @ whiten @ (after - before)
    if not inertial[0] > 0:
        raise MethodError(
            f"The payload's mass comes out as {inertial[0]:.3g} kg; expected a positive one: check that the second "
            "record is the one with the payload, and that both have the same torque's unit."
        )
    return Payload(link, inertial, covariance_of(spread))
