"""Start of the search of a robot's springs: the robot of rigid joints, split into rotors, springs and links.

It fixes sums: of both sides' friction, of rotor and link. These are split, what it says of each by how well it knows
it, and each spring is given a frequency of rotor against link.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray, column_norms, triangle
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import Bounds, Parameter, Quantity
from jointid.estimation.parameters import RobotParameters
from jointid.estimation.problems.simulated import Simulated, outcome_of
from jointid.models.joints import spring_at
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import Outcome

if TYPE_CHECKING:
    from jointid.estimation.robots.didim import RobotFit

STIFFEST = 0.15
"""Of the sampling frequency: the highest mode that is searched."""

_POSES = 40  # along the references, over which inertias are averaged
_SHARE = 0.5  # of the inertia about a joint, at most, that its rotor begins with
_ROOM = 0.6  # of what the rotors can take before the links' mass matrix is not positive
_SPREADS = (1.0, 0.3, 0.1, 0.03, 0.01)  # of the inertia about a joint: how far its rotor may be from what is wanted
_LIGHTEST = 0.05  # of the inertia about a joint: a rotor that a search begins with
_DAMPING = 0.03  # of critical, of the springs a search begins with
_MODES = tuple(5.0 * 1.5**i for i in range(6))  # Hz: 5 to 38, the grid in which a frequency is searched
_STIFF = 0.07  # of the sampling frequency: where a joint is as good as rigid, and still takes one step a period
_SOFTEST = 1e-3  # of the sampling frequency: the lowest mode that is searched


@dataclass(frozen=True, slots=True, eq=False)
class SplitRobot:
    """A rigid robot split into rotors, springs and links.

    Attributes:
        problem: of the flexible robot.
        split: (parameters,) all but the springs.
        reduced: (n,) inertias that swing on the springs of free joints.
    """

    problem: Simulated
    split: FloatArray
    reduced: FloatArray

    @classmethod
    def of(cls, problem: Simulated, rigid: RobotFit) -> SplitRobot:
        """Split a rigid robot: friction in halves, rotors as large as the links' mass matrix lets them be.

        Least squares of what the rigid robot's parameters say, each as well as it is known, and of the wanted rotors.
        Of the rotors that the rigid robot tells apart from their links some it hardly knows, and with these as they are
        the links' mass matrix may not be positive. So what is taken for granted of the rotors is more and more, until
        the robot can be simulated on stiff springs.
        """
        numbers = problem.parameters.base
        whole = rigid.parameters.numbers(rigid.values)
        poses = np.vstack([log.poses for log in problem.logs])
        masses = np.array([_mass_matrix(problem, whole, pose) for pose in poses[:: max(len(poses) // _POSES, 1)]])
        if not np.min(np.linalg.eigvalsh(masses)) > 0.0:
            raise MethodError(
                "The robot of rigid joints that the search of springs begins with has a mass matrix that is not "
                "positive in a pose of the record, so the record hardly tells the masses; move all joints faster, and "
                "differently from each other, or longer."
            )
        about = np.mean(np.diagonal(masses, axis1=1, axis2=2), axis=0)
        # Of a matrix M that is positive M - diag(r) is, too, for r up to this share of what each joint feels alone.
        alone = np.min(1.0 / np.diagonal(np.linalg.inv(masses), axis1=1, axis2=2), axis=0)
        root = 1.0 / np.sqrt(np.outer(alone, alone))
        taken = min(float(np.linalg.eigvalsh(M * root)[0]) for M in masses)
        wanted = np.where(numbers.flexible, np.minimum(_SHARE * about, _ROOM * taken * alone), 0.0)

        parameters, unit = problem.parameters, np.eye(len(problem.free))
        zero = _stiffen(np.zeros(len(unit)), parameters, rigid)
        felt = np.column_stack([_stiffen(one, parameters, rigid) - zero for one in unit])
        # Beside the information the covariance has lost what is known of the sum of two that are not known.
        known = triangle(rigid.slopes * rigid.problem.weights(len(rigid.slopes))[:, np.newaxis])
        own = [c for c, p in enumerate(parameters.places) if p.own == "inertia"]
        joints = np.array([parameters.places[c].axis for c in own], dtype=np.int64)
        began, lower = np.zeros(len(unit)), Bounds.of(problem.free).lower.copy()  # a friction is not negative
        began[own], lower[own] = wanted[joints], np.where(numbers.flexible, _LIGHTEST * about, -math.inf)[joints]
        target = np.concatenate([known @ (rigid.values[: len(known)] - zero - felt @ began), np.zeros(len(own))])
        for spread in _SPREADS:
            rows = np.vstack([known @ felt, unit[own] / (spread * about[joints])[:, np.newaxis]])
            norms = column_norms(rows)
            values = np.maximum(began + np.linalg.lstsq(rows / norms, target, rcond=None)[0] / norms, lower)
            rotors = wanted.copy()
            rotors[joints] = values[own]
            links = np.maximum(about - rotors, _LIGHTEST * about)
            start = cls(problem, parameters.fill(values), rotors * links / (rotors + links))
            stiff = parameters.to_search_variables(start.values(start.stiff))
            if outcome_of(problem.run(stiff, keep=False)) is Outcome.FINISHED:
                break
        return start

    @property
    def stiff(self) -> float:
        """The frequency at which a flexible joint is as good as rigid, Hz."""
        return _STIFF / self.problem.sample_time

    def values(self, hertz: FloatArray | float) -> FloatArray:
        """Return all parameters, (parameters,), with springs of these frequencies, (n,) or one for all."""
        values, each = self.split.copy(), np.broadcast_to(hertz, self.reduced.shape)
        for c, place in enumerate(self.problem.parameters.places):
            if place.name in ("stiffness", "damping"):
                values[c] = spring_at(each[place.axis], self.reduced[place.axis], _DAMPING)[place.name]
        return values

    def search(self) -> FloatArray:
        """Return a frequency for each joint, (n,): of a row that with which its own torque is explained best.

        All joints have the same frequency in a run: what one's spring does to the torques of others is small beside
        what it does to its own, and a run for each joint and frequency would take as many times as long. Of a joint
        without a spring it is 0.
        """
        problem = self.problem
        row = [f for f in _MODES if f < self.stiff]
        if not row:
            raise MethodError(
                f"Modes are searched from {_MODES[0]:g} Hz on, which records of {problem.sample_time:g} s a sample do "
                "not show; log faster, or leave the springs out."
            )

        def costs(frequency: float) -> FloatArray:
            return problem.norms(problem.residual(problem.parameters.to_search_variables(self.values(frequency))))

        return np.where(problem.parameters.base.flexible, np.take(row, np.argmin(in_threads(costs, row), axis=0)), 0.0)

    def bound(self, problem: Simulated) -> Simulated:
        """Return the problem with bounds on each spring."""
        lowest, highest = (share / problem.sample_time for share in (_SOFTEST, STIFFEST))

        def within(place: Place, parameter: Parameter) -> Parameter:
            if parameter.quantity is not Quantity.STIFFNESS:
                return parameter
            softest, stiffest = (spring_at(f, self.reduced[place.axis])["stiffness"] for f in (lowest, highest))
            return replace(parameter, lower=math.log(softest), upper=math.log(stiffest))

        own = problem.parameters
        bounded = tuple(within(place, one) for place, one in zip(own.places, own.parameters, strict=True))
        return replace(problem, parameters=replace(own, parameters=bounded))


def _mass_matrix(problem: Simulated, numbers: Numbers, pose: FloatArray) -> FloatArray:
    """Return that of a robot of rigid joints, rotors included, (n, n)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    still, room = np.zeros(pose.size), np.empty((pose.size, ROOM))
    M = np.empty((pose.size, pose.size))
    equations_of_motion(problem.log.tree, numbers.inertials, pose, still, still, room, M, np.empty(pose.size))
    return M + np.diag([own["inertia"] for own in numbers.values])


def _stiffen(values: FloatArray, parameters: RobotParameters, rigid: RobotFit) -> FloatArray:
    """Return the rigid robot's parameters of a flexible one with these values, (free,), and stiff springs."""
    found, base, each = parameters.numbers(parameters.fill(values)), rigid.parameters.base, list[dict[str, float]]()
    for own, like in zip(found.values, base.values, strict=True):
        both = {name: sum(own.get(f"{side}{name}", 0.0) for side in ("", "motor_", "load_")) for name in like}
        link = own.get("load_viscous", 0.0)  # the link's own friction is the same in both directions
        each.append(both | {name: both[name] + link for name in both if name.startswith("viscous_")})
    return rigid.parameters.group(replace(base, values=tuple(each), inertials=found.inertials))[: len(rigid.x)]
