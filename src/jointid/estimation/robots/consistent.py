"""Standard parameters of a robot that bodies can have, near those of its model: what a simulation or a URDF needs.

Base parameters leave open how masses are spread over the links, and noise may give sums that no bodies have: a mass
matrix that is not positive makes a simulation fall apart. Here every link is ``exp(alpha) U U'`` [Rucker and Wensing
2022], a body whatever the numbers, and the least of::

    (x(theta) - x)' V^-1 (x(theta) - x)  +  |(theta - theta0) / spread|^2

is taken: x and V are the estimate and its covariance, theta0 the model's own bodies. Where the record says much, it
decides; where it says nothing, the model stays.
"""

from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import join
from jointid.estimation.parameters import standard_index
from jointid.estimation.result.estimate import Estimate
from jointid.models.robots.inertial import from_log_cholesky, log_cholesky, pseudo_inertia
from jointid.models.robots.robot import Robot
from jointid.simulation.plant import LOAD_STATE, LOG_DELAY, Numbers, Place, robot_with
from jointid.uncertainty.covariance import Covariance

_SPREAD = 0.3
"""How far the model's bodies may be off, as a share: the standard deviation of logarithms, and of lengths."""

_SIGNED = ("offset", "stribeck_force", "viscous_drift", "coulomb_drift", "cubic_stiffness", LOG_DELAY, *LOAD_STATE)
"""Names, without the side, of numbers that a robot may have below 0."""

MISFIT = 2.0
"""Standard deviations of an estimate, rms, up to which bodies fit it."""

_THIN = 1e-6  # of a body's second moments: what a rod or a plate is given across itself
_FLOOR = 1e-10  # of the largest variance of a correlation: rounding
_SETTLED = 1e-6  # relative, of the search
_TIGHTER = 3.0  # times, from search to search, that errors are smaller
_NEARLY = 1e-2  # relative, of a search whose errors are not yet those of the estimate


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
    """Return the robot nearest to the model of an estimate whose parameters are the estimate's, as far as bodies can.

    Args:
        estimate: of a robot, by any method.

    Raises:
        MethodError: a link of the model has no mass, so that there is nothing to be near; or the record does not show
            a spring, so that it does not part its rotor from its link.
    """
    from scipy.optimize import least_squares

    part = estimate.require_robot()
    require_shown(estimate)
    prior, parameters, numbers = part.model, part.parameters, part.numbers()
    n, size = len(prior), len(parameters.places)
    values, covariance = part.values, estimate.covariance_of(part.names)
    base = Numbers.of(prior).with_record(parameters.base)
    # The parameters are sums of what stands alone, as friction, offsets and springs, and of the bodies.
    both = np.hstack([np.eye(size), parameters.grouping])
    every = [*enumerate(parameters.places), *enumerate(parameters.dropped, start=size)]
    apart = [(column, place) for column, place in every if standard_index(place, n) is None]
    own = tuple(place for _, place in apart)
    others = np.array([(numbers if column < size else base)[place] for column, place in apart])
    least = np.array([-np.inf if place.own in _SIGNED else 0.0 for place in own])
    motors = [Place(i, f"{joint.sides[0]}inertia") for i, joint in enumerate(base.joints)]
    of_standard, of_others = parameters.of_standard, both[:, [column for column, _ in apart]]
    bodies, scales = _prior_bodies(prior)
    rotors, links = prior.of_joints("rotor_inertia"), np.diag(mass_matrix_at(prior, np.zeros(n)))
    # A URDF has no place for a rotor: 0 says nothing of it, so nothing holds it there.
    unknown = rotors <= 0.0
    near = np.concatenate([bodies, rotors])
    spread = _SPREAD * np.concatenate([scales, np.where(unknown, np.inf, np.maximum(rotors, 0.1 * links))])
    whiten = whitening(covariance)

    def away(x: FloatArray) -> FloatArray:
        """Return how far the parameters of bodies, rotors and others are from those stated, (parameters,)."""
        links = [from_log_cholesky(theta)[0] for theta in x[: 10 * n].reshape(n, 10)]
        standard = np.concatenate([*links, x[10 * n : 11 * n]])
        return np.asarray(of_standard @ standard + of_others @ x[11 * n :] - values)

    def residual(x: FloatArray, larger: float = 1.0) -> FloatArray:
        return np.concatenate([whiten @ away(x) / larger, (x[: 11 * n] - near) / spread])

    def jacobian(x: FloatArray, larger: float) -> FloatArray:
        slopes = np.eye(11 * n)
        for k, theta in enumerate(x[: 10 * n].reshape(n, 10)):
            slopes[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = from_log_cholesky(theta)[1]
        found = np.zeros((len(whiten) + 11 * n, x.size))
        found[: len(whiten)] = whiten @ np.hstack([of_standard @ slopes, of_others]) / larger
        found[len(whiten) :, : 11 * n] = np.diag(1.0 / spread)
        return found

    def misfit_of(x: FloatArray) -> float:
        return float(np.sqrt(np.mean((whiten @ away(x)) ** 2)))

    lower = np.concatenate([np.full(10 * n, -np.inf), np.zeros(n), least])
    others = np.where(np.isfinite(least), np.abs(others), others)
    # From its bound a search does not move a rotor.
    x = np.concatenate([bodies, np.where(unknown, 0.1 * links.max(), rotors), others])
    x = np.maximum(x, np.where(np.isfinite(lower), 1e-9, -np.inf))
    # Small errors make a narrow curved valley, in which one search stops far from the model: a wrist of 2 m.
    larger = max(misfit_of(x), 1.5)
    while larger > 1.0:
        larger = max(larger / _TIGHTER, 1.0)
        settled = _NEARLY if larger > 1.0 else _SETTLED
        x = least_squares(
            residual, x, jacobian, bounds=(lower, np.inf), args=(larger,), x_scale="jac", ftol=settled, xtol=settled,
            max_nfev=1000,
        ).x  # fmt: skip
    inertials = np.array([from_log_cholesky(theta)[0] for theta in x[: 10 * n].reshape(n, 10)])
    off = np.abs(away(x)) / _positive(covariance.std)
    worst = tuple(part.names[k] for k in np.argsort(-off) if off[k] > MISFIT)
    there = replace(base, inertials=inertials).with_values([*own, *motors], [*x[11 * n :], *x[10 * n : 11 * n]])
    return ConsistentRobot(robot_with(prior, there), misfit_of(x), worst)


def require_shown(estimate: Estimate) -> None:
    """Refuse an estimate of a robot with a spring that the record does not show.

    Raises:
        MethodError: there is one.
    """
    if hidden := [row.axis for row in estimate.rows if row.name.endswith(".stiffness") and row.value is None]:
        raise MethodError(
            f"The record does not show the spring of {join(hidden)}, so it does not part motor from link there; "
            "leave this spring out of the robot file, or excite its mode."
        )


def mass_matrix_at(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the mass matrix of links and rotors, (n, n), at a pose, (n,)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n, coupling = len(robot), robot.coupling
    links, still = np.empty((n, n)), np.zeros(n)
    tree = robot.tree._replace(joints=np.zeros((0, 0)))  # the pose is of the joints, not of the motors' shafts
    pose = np.ascontiguousarray(q, dtype=np.float64)
    equations_of_motion(tree, robot.inertials, pose, still, still, np.empty((n, ROOM)), links, np.empty(n))
    return np.asarray(links + coupling.T @ np.diag(robot.of_joints("rotor_inertia")) @ coupling)


def _prior_bodies(prior: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the log-Cholesky parameters of all links, (10 n,), and their natural sizes: 1, or a length."""
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
    return np.asarray((vectors / np.sqrt(np.maximum(values, _FLOOR * values[-1]))).T / _positive(covariance.std))


def _positive(std: FloatArray) -> FloatArray:
    """Return standard errors, that of a fixed parameter as the smallest one."""
    return np.where(std > 0, std, np.min(std[std > 0], initial=1.0))
