"""Standard parameters of a robot that bodies can have, near those of its model: what a simulation or a URDF needs.

Base parameters leave open how masses are spread over the links, and noise may give sums that no bodies have: a mass
matrix that is not positive makes a simulation fall apart. Here every link is ``exp(alpha) U U'`` [Rucker and Wensing
2022], a body whatever the numbers, and the least of::

    (x(theta) - x)' V^-1 (x(theta) - x)  +  |(theta - theta0) / spread|^2

is taken: x and V are the estimate and its covariance, theta0 the model's own bodies. Where the record says much, it
decides; where it says nothing, the model stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.estimation.result.estimate import Estimate
from jointid.models.robots.inertial import from_log_cholesky, log_cholesky, pseudo_inertia
from jointid.models.robots.robot import Robot
from jointid.uncertainty.covariance import Covariance

_SPREAD = 0.3
"""How far the model's bodies may be off, as a share: the standard deviation of logarithms, and of lengths."""

MISFIT = 2.0
"""Standard deviations of an estimate, rms, up to which bodies fit it."""

_THIN = 1e-6  # of a body's second moments: what a rod or a plate is given across itself
_FLOOR = 1e-10  # of the largest variance of a correlation: rounding
_POSES = 1000
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
        least_inertia: smallest eigenvalue of the mass matrix, rotors and all, over a thousand random poses.
    """

    robot: Robot
    misfit: float
    worst: tuple[str, ...]
    least_inertia: float


def consistent_robot(estimate: Estimate) -> ConsistentRobot:
    """Return the robot nearest to the model of an estimate whose parameters are the estimate's, as far as bodies can.

    Args:
        estimate: of a robot, by any method.

    Raises:
        MethodError: a link of the model has no mass, so that there is nothing to be near; or the record does not show
            a spring, so that it does not part its rotor from its link.
    """
    from scipy.optimize import least_squares

    found_robot = estimate.require_robot()
    prior = found_robot.model
    n, stated = len(prior), found_robot.sums(prior)
    theta0, scales = _prior_bodies(prior)
    rotors0 = prior.of_joints("rotor_inertia")
    links = np.diag(mass_matrix_at(prior, np.zeros(n)))
    # A URDF has no place for a rotor: 0 says nothing of it, so nothing holds it there.
    unknown = rotors0 <= 0.0
    sizes = np.where(unknown, np.inf, np.maximum(rotors0, 0.1 * links))
    whiten = _whitening(stated.covariance)
    sums = np.hstack([stated.of_standard, stated.of_others])

    def unpack(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        bodies = [from_log_cholesky(theta) for theta in x[: 10 * n].reshape(n, 10)]
        standard = np.concatenate([*(body for body, _ in bodies), x[10 * n : 11 * n]])
        slopes = np.zeros((11 * n, 11 * n))
        for k, (_, slope) in enumerate(bodies):
            slopes[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = slope
        slopes[10 * n :, 10 * n :] = np.eye(n)
        return standard, slopes

    def residual(x: FloatArray, larger: float = 1.0) -> FloatArray:
        standard, _ = unpack(x)
        off = sums @ np.concatenate([standard, x[11 * n :]]) - stated.values
        near = np.concatenate([(x[: 10 * n] - theta0) / scales, (x[10 * n : 11 * n] - rotors0) / sizes]) / _SPREAD
        return np.concatenate([whiten @ off / larger, near])

    def jacobian(x: FloatArray, larger: float) -> FloatArray:
        _, slopes = unpack(x)
        found = np.zeros((len(whiten) + 11 * n, x.size))
        found[: len(whiten), : 11 * n] = whiten @ stated.of_standard @ slopes / larger
        found[: len(whiten), 11 * n :] = whiten @ stated.of_others / larger
        found[len(whiten) :, : 11 * n] = np.diag(1 / np.concatenate([scales, sizes])) / _SPREAD
        return found

    lower = np.concatenate([np.full(10 * n, -np.inf), np.zeros(n), stated.least])
    others = np.where(np.isfinite(stated.least), np.abs(stated.others), stated.others)
    # From its bound a search does not move a rotor.
    x = np.concatenate([theta0, np.where(unknown, 0.1 * links.max(), rotors0), others])
    x = np.maximum(x, np.where(np.isfinite(lower), 1e-9, -np.inf))

    def misfit_of(x: FloatArray) -> float:
        return float(np.sqrt(np.mean(residual(x)[: len(whiten)] ** 2)))

    # Small errors make a narrow curved valley, in which one search stops far from the model: a wrist of 2 m.
    larger = max(misfit_of(x), 1.5)
    while larger > 1.0:
        larger = max(larger / _TIGHTER, 1.0)
        settled = _NEARLY if larger > 1.0 else _SETTLED
        x = least_squares(
            residual, x, jacobian, bounds=(lower, np.inf), args=(larger,), x_scale="jac", ftol=settled, xtol=settled,
            max_nfev=1000,
        ).x  # fmt: skip
    standard, _ = unpack(x)
    robot = stated.robot(standard[: 10 * n].reshape(n, 10), standard[10 * n :], x[11 * n :])
    misfit = misfit_of(x)
    off = np.abs(sums @ np.concatenate([standard, x[11 * n :]]) - stated.values) / _positive(stated.covariance.std)
    worst = tuple(found_robot.names[k] for k in np.argsort(-off) if off[k] > MISFIT)
    return ConsistentRobot(robot, misfit, worst, least_inertia(robot))


def mass_matrix_at(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the mass matrix of links and rotors, (n, n), at a pose, (n,)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    n, coupling = len(robot), robot.coupling
    links, still = np.empty((n, n)), np.zeros(n)
    tree = robot.tree._replace(joints=np.zeros((0, 0)))  # the pose is of the joints, not of the motors' shafts
    pose = np.ascontiguousarray(q, dtype=np.float64)
    equations_of_motion(tree, robot.inertials, pose, still, still, np.empty((n, ROOM)), links, np.empty(n))
    return np.asarray(links + coupling.T @ np.diag(robot.of_joints("rotor_inertia")) @ coupling)


def least_inertia(robot: Robot) -> float:
    """Return the smallest eigenvalue of the mass matrix over random poses: what is not positive cannot be simulated."""
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (_POSES, len(robot)))
    return min(float(np.linalg.eigvalsh(mass_matrix_at(robot, one))[0]) for one in q)


def _prior_bodies(prior: Robot) -> tuple[FloatArray, FloatArray]:
    """Return the log-Cholesky parameters of all links, (10 n,), and their natural sizes: 1, or a length."""
    massless = [link.name for link in prior.links if not link.inertial[0] > 0]
    if massless:
        raise MethodError(
            f"The model says no mass of {', '.join(massless)}; expected one on every link, to be near to: add it to "
            "the model, a rough one will do."
        )
    found, sizes = [], []
    for link in prior.links:
        pseudo = pseudo_inertia(link.inertial)
        thick = pseudo + _THIN * np.trace(pseudo[:3, :3]) * np.diag([1.0, 1.0, 1.0, 0.0])
        try:
            found.append(log_cholesky(thick))
        except np.linalg.LinAlgError:
            raise MethodError(
                f"No body can have the inertial parameters of the link {link.name} in the model; expected positive "
                "second moments: correct its mass, centre or inertia."
            ) from None
        length = np.sqrt(np.trace(thick[:3, :3]) / thick[3, 3])
        sizes.append([1.0, 1.0, 1.0, 1.0, *6 * [length]])
    return np.concatenate(found), np.concatenate(sizes)


def _whitening(covariance: Covariance) -> FloatArray:
    """Return the whitening matrix of an estimate."""
    std = _positive(covariance.std)
    values, vectors = np.linalg.eigh(covariance.correlation)
    return np.asarray((vectors / np.sqrt(np.maximum(values, _FLOOR * values[-1]))).T / std)


def _positive(std: FloatArray) -> FloatArray:
    """Return standard errors, that of a fixed parameter as the smallest one."""
    return np.where(std > 0, std, np.min(std[std > 0], initial=1.0))
