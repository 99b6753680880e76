"""Bodies of a robot's estimate: links near the model's, and the payload.

**Links.** Base parameters do not determine the distribution of masses over the links, and noise may give inconsistent
sums: a mass matrix that is not positive makes a simulation diverge. Here every link is ``exp(alpha) U U'`` [Rucker and
Wensing 2022], which is consistent for all numbers, and the least of::

    (x(theta) - x)' V^-1 (x(theta) - x)  +  |(theta - theta0) / spread|^2

is taken: x and V are the estimate and its covariance, theta0 the model's own bodies. The record decides the parameters
that it determines; the others stay at the model.

**A payload**, its mass, centre and inertia, is the difference of the estimates with and without it, by
generalised least squares over the sums of inertial parameters in both, with the covariance of each. Friction is
each estimate's own: it changes as gears warm up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Table, Text
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.text import interval, join, number
from jointid.estimation.identify import fit
from jointid.estimation.methods import Method
from jointid.estimation.parameters import mass_matrix_at, standard_index
from jointid.estimation.result.estimate import Estimate
from jointid.models.robots.inertial import (
    SYMBOLS,
    from_log_cholesky,
    is_physical,
    log_cholesky,
    mass_properties,
    pseudo_inertia,
)
from jointid.models.robots.robot import Robot, RobotLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.plant import LOAD_STATE, LOG_DELAY, Numbers, Place, robot_with
from jointid.uncertainty.covariance import INTERVAL, Covariance, covariance_of

_SPREAD = 0.3
"""How far the model's bodies may be off, as a share: the standard deviation of logarithms, and of lengths."""

_SIGNED = ("offset", "stribeck_force", "viscous_drift", "coulomb_drift", "cubic_stiffness", LOG_DELAY, *LOAD_STATE)
"""Names, without the side, of numbers that a robot may have below 0."""

MISFIT = 2.0
"""Standard deviations of an estimate, rms, up to which bodies fit it."""

_THIN = 1e-6  # of a body's second moments: what a rod or a plate is given across itself

_ROWS = (
    *(("mass", "kg"), ("centre x", "m"), ("centre y", "m"), ("centre z", "m")),
    *((f"inertia {axes}", "kg m2") for axes in ("xx", "yy", "zz", "xy", "xz", "yz")),
)


@dataclass(frozen=True, slots=True, eq=False)
class ConsistentRobot:
    """A robot with bodies that fit an estimate.

    Attributes:
        robot: the model with the masses, rotors, friction and springs found.
        misfit: root mean square of the parameters away from the estimate, in its deviations.
        worst: names of the parameters that are further away than `MISFIT`, the furthest first.
    """

    robot: Robot
    misfit: float
    worst: tuple[str, ...]


def consistent_robot(estimate: Estimate) -> ConsistentRobot:
    """Robot with consistent bodies nearest to both model and estimate.

    Args:
        estimate: of a robot, by any method.

    Raises:
        MethodError: a link of the model has no mass, so that no nearest body exists; or the record does not show
            a spring, so that it does not separate its rotor from its link.
    """
    from scipy.linalg import block_diag
    from scipy.optimize import least_squares

    part = estimate.require_robot()
    require_shown(estimate)
    prior, parameters, numbers = part.model, part.parameters, part.numbers()
    n, size = len(prior), len(parameters.places)
    values, covariance = part.values, estimate.covariance_of(part.names)
    base = Numbers.of(prior).with_record(parameters.base)
    # The parameters are sums of what stands alone, as friction, offsets and springs, and of the bodies.
    both, every = np.hstack([np.eye(size), parameters.grouping]), (*parameters.places, *parameters.dropped)
    apart = [column for column, place in enumerate(every) if standard_index(place, n) is None]
    own, others = [every[c] for c in apart], np.array([(numbers if c < size else base)[every[c]] for c in apart])
    weights, whiten = np.hstack([parameters.of_standard, both[:, apart]]), whitening(covariance)
    least = np.array([-np.inf if place.own in _SIGNED else 0.0 for place in own])
    motors = [Place(i, f"{joint.sides[0]}inertia") for i, joint in enumerate(base.joints)]
    bodies, scales = _prior_bodies(prior)
    rotors = prior.of_joints("rotor_inertia")
    links = np.diag(mass_matrix_at(prior.tree, prior.inertials, np.zeros(n))) + rotors
    unknown = rotors <= 0.0  # a URDF has no place for a rotor: 0 says nothing of it, so nothing holds it there
    near = np.concatenate([bodies, rotors])
    spread = _SPREAD * np.concatenate([scales, np.where(unknown, np.inf, np.maximum(rotors, 0.1 * links))])

    def bodies_of(x: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Inertial parameters of all links, (n, 10), and derivatives, (10, 10) each."""
        found, slopes = zip(*map(from_log_cholesky, x[: 10 * n].reshape(n, 10)), strict=True)
        return np.array(found), list(slopes)

    def away(x: FloatArray) -> FloatArray:
        """Difference of the parameters of bodies and others from the estimate, (parameters,)."""
        return np.asarray(weights @ np.concatenate([bodies_of(x)[0].ravel(), x[10 * n :]]) - values)

    def residual(x: FloatArray, larger: float) -> FloatArray:
        return np.concatenate([whiten @ away(x) / larger, (x[: 11 * n] - near) / spread])

    def jacobian(x: FloatArray, larger: float) -> FloatArray:
        slopes = block_diag(*bodies_of(x)[1], np.eye(x.size - 10 * n))
        return np.vstack([whiten @ weights @ slopes / larger, np.eye(11 * n, x.size) / spread[:, np.newaxis]])

    def misfit_of(x: FloatArray) -> float:
        return float(np.hypot.reduce(whiten @ away(x)) / np.sqrt(size))

    lower = np.concatenate([np.full(10 * n, -np.inf), np.zeros(n), least])
    x = np.concatenate([bodies, np.where(unknown, 0.1 * links.max(), rotors), others])
    x = np.where(np.isfinite(lower), np.maximum(np.abs(x), 1e-9), x)  # a search does not move what is at its bound
    # Small errors make a narrow curved valley, in which one search stops far from the model: a wrist of 2 m.
    if not (larger := max(misfit_of(x), 1.5)) < 1e100:  # whose square is a number
        raise MethodError("The estimate has values that no robot comes near to; identify the robot again.")
    while larger > 1.0:
        larger = max(larger / 3.0, 1.0)  # times, from search to search, that errors are smaller
        settled = 1e-2 if larger > 1.0 else 1e-6  # relative; the last search has the errors of the estimate
        x = least_squares(
            residual, x, jacobian, bounds=(lower, np.inf), args=(larger,), x_scale="jac", ftol=settled, xtol=settled,
            max_nfev=1000,
        ).x  # fmt: skip
    off = np.abs(away(x)) / _positive(covariance.std)
    worst = tuple(part.names[k] for k in np.argsort(-off) if off[k] > MISFIT)
    there = replace(base, inertials=bodies_of(x)[0]).with_values([*own, *motors], [*x[11 * n :], *x[10 * n : 11 * n]])
    return ConsistentRobot(robot_with(prior, there), misfit_of(x), worst)


def require_shown(estimate: Estimate) -> None:
    """Refuse a robot's estimate with a spring that the record hides.

    Raises:
        MethodError: there is one.
    """
    if hidden := [row.axis for row in estimate.rows if row.name.endswith(".stiffness") and row.value is None]:
        raise MethodError(
            f"The record does not show the spring of {join(hidden)}, so it does not separate motor and link there; "
            "leave this spring out of the robot file, or excite its mode."
        )


def _prior_bodies(prior: Robot) -> tuple[FloatArray, FloatArray]:
    """Log-Cholesky parameters of all links, (10 n,), and their natural sizes."""
    found, sizes = [], []
    for link in prior.links:
        pseudo = pseudo_inertia(link.inertial)
        thick = pseudo + _THIN * np.trace(pseudo[:3, :3]) * np.diag([1.0, 1.0, 1.0, 0.0])
        try:
            found.append(log_cholesky(thick))
        except np.linalg.LinAlgError:
            raise MethodError(
                f"No body can have the inertial parameters of the link {link.name} in the model; expected a mass, and "
                "positive second moments, to be near to: correct its mass, centre or inertia; rough ones will do."
            ) from None
        length = np.sqrt(np.trace(thick[:3, :3]) / thick[3, 3])
        sizes.append([1.0, 1.0, 1.0, 1.0, *6 * [length]])
    return np.concatenate(found), np.concatenate(sizes)


def whitening(covariance: Covariance) -> FloatArray:
    """Return the matrix that makes errors of this covariance white, (parameters, parameters)."""
    values, vectors = np.linalg.eigh(covariance.correlation)
    return np.asarray((vectors / np.sqrt(np.maximum(values, 1e-10 * values[-1]))).T / _positive(covariance.std))


def _positive(std: FloatArray) -> FloatArray:
    """Standard errors; a fixed parameter gets the smallest one."""
    return np.where(std > 0, std, np.min(std[std > 0], initial=1.0))


# A payload


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
        """Mass, centre and inertia at the centre, (10,), and deviations, (10,)."""
        values = _convert(self.inertial)
        steps = 1e-6 * np.maximum(np.abs(self.inertial), self.covariance.std)  # of a difference, relative
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
        """True if a body can have the ten identified parameters."""
        return is_physical(self.inertial)

    def to_document(self, *, details: bool = False) -> Document:
        """Mass and centre first, then each number; there are no further details."""
        del details
        each = zip(_ROWS, *self.properties, strict=True)
        lines = [(name, interval(value, INTERVAL * std), unit) for (name, unit), value, std in each]
        at = ", ".join(number(float(one), 3) for one in self.properties[0][1:4])
        first = f"The payload weighs {lines[0][1]} kg, 2 sigma, with its centre at ({at}) m of {self.link}."
        said = "" if self.possible else "No body has just these numbers; those that are not known may be far off."
        title = f"in the frame of {self.link}; inertia at the centre"
        return Document(
            first,
            (
                *([Text(said, style="bad")] if said else []),
                Table(("", "value, 2 sigma", "unit"), tuple(lines), title, (0, 1, 2)),
                Facts(tuple(("warning", one) for one in self.warnings)),
            ),
        )


def _convert(inertial: FloatArray) -> FloatArray:
    body = mass_properties(inertial)
    return np.array([body.mass, *body.centre, *body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]])


@one_thread
def identify_payload(
    model: Robot | RobotLoop,
    empty: Sequence[Record] | Estimate,
    loaded: Sequence[Record],
    method: Method | None = None,
    *,
    filtering: Filtering | None = None,
    progress: Progress = ignore_progress,
) -> Payload:
    """Identify a payload of the last link from records without and with.

    Args:
        model: the robot's geometry, gravity and coupling for IDIM; the robot under its controllers, whose gains are the
            same with the payload, for DIDIM; or a flexible robot for the drive side.
        empty: the record of each joint without the payload, or the robot's estimate by the same method.
        loaded: the record of each joint with it; another motion will do.
        method: as of `jointid.identify`.
        filtering: of positions, torques and rows.
        progress: receives the steps.

    Raises:
        MethodError: see `payload_difference`; or the method does not fit the model.
        RecordError: as of `jointid.identify`.
    """

    def estimate(log: Sequence[Record] | Estimate) -> Estimate:
        if isinstance(log, Estimate):
            return log
        if any(record.payload for record in log):
            raise MethodError(
                "A record states its payload, which is to be identified here; leave payload_mass of [[records]], or "
                "Record.payload, out."
            )
        return fit(log, model, method, filtering=filtering, progress=progress)

    return payload_difference(estimate(empty), estimate(loaded))


def payload_difference(empty: Estimate, loaded: Estimate) -> Payload:
    """Payload as the difference of two robot estimates, by generalised least squares.

    Args:
        empty: without the payload.
        loaded: with it, of the same robot by the same method.

    Raises:
        MethodError: the estimates are of two robots or methods, an estimate did not settle or refuses a parameter, the
            robot does not determine all of a payload, or its mass is negative.
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
    hidden = directions[int(np.sum(sizes > 1e-8 * sizes[0])) :]
    if len(hidden):
        lost = [SYMBOLS[k] for k in np.flatnonzero(np.max(np.abs(hidden), axis=0) > 0.2)]
        raise MethodError(
            f"This robot does not show all of a payload: {join(lost)} act on no torque, or only together; expected "
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
    said = dict.fromkeys((*empty.warnings, *loaded.warnings))
    return Payload(link, inertial, covariance_of(spread), tuple(said))
