"""Start of the search of a robot's springs: the robot of rigid joints, split into rotors, springs and links.

It fixes sums: of both sides' friction, of rotor and link. These are split, what it says of each by how well it knows
it, and each spring is given a frequency of rotor against link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Progress
from jointid.common.parallel import in_threads, threads
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.problems.simulated import Simulated, outcome_of
from jointid.estimation.robots.fit import RobotFit
from jointid.estimation.robots.numbers import RobotParameters
from jointid.models.joints import spring_at
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.simulate import Outcome

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
class StartOfSprings:
    """The rigid robot split into rotors, springs and links.

    Attributes:
        problem: of the flexible robot. names: of its joints.
        split: (parameters,) all but the springs.
        rotors, links: (n,) inertias of the rotors, and of the links about the joints.
    """

    problem: Simulated
    names: tuple[str, ...]
    split: FloatArray
    rotors: FloatArray
    links: FloatArray

    @classmethod
    def of(cls, problem: Simulated, rigid: RobotFit, names: tuple[str, ...]) -> StartOfSprings:
        """Split a rigid robot: friction in halves, rotors as large as the links' mass matrix lets them be.

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

        def split(spread: float) -> tuple[StartOfSprings, bool]:
            values, rotors = _split(problem.parameters, rigid, numbers, wanted, spread * about, _LIGHTEST * about)
            start = cls(problem, names, values, rotors, np.maximum(about - rotors, _LIGHTEST * about))
            stiff = problem.parameters.to_search_variables(start.all_at(start.stiff))
            return start, outcome_of(problem.run(stiff, keep=False)) is Outcome.FINISHED

        for first in range(0, len(_SPREADS), threads()):
            for start, runs in in_threads(split, _SPREADS[first : first + threads()]):
                if runs:
                    return start
        return start

    @property
    def reduced(self) -> FloatArray:
        """Inertias that swing on the springs of free joints, (n,)."""
        return self.rotors * self.links / (self.rotors + self.links)

    @property
    def stiff(self) -> float:
        """The frequency at which a flexible joint is as good as rigid, Hz."""
        return _STIFF / self.problem.sample_time

    def all_at(self, frequency: float) -> FloatArray:
        """Return all parameters with one frequency of all springs."""
        return self.values(dict.fromkeys(self.names, frequency))

    def values(self, hertz: Mapping[str, float]) -> FloatArray:
        """Return all parameters with springs of these frequencies, (parameters,)."""
        values = self.split.copy()
        for c, place in enumerate(self.problem.parameters.places):
            if place.name in ("stiffness", "damping"):
                spring = spring_at(hertz[self.names[place.axis]], float(self.reduced[place.axis]), _DAMPING)
                values[c] = spring[place.name]
        return values

    def search(self, progress: Progress) -> dict[str, float]:
        """Return a frequency for each flexible joint: of a row that with which its own torque is explained best.

        All joints have the same frequency in a run: what one's spring does to the torques of others is small beside
        what it does to its own, and a run for each joint and frequency would take as many times as long.
        """
        row = frequency_row(self.problem.sample_time)

        def costs(frequency: float) -> FloatArray:
            values = self.problem.parameters.to_search_variables(self.all_at(frequency))
            return self.problem.norms(self.problem.residual(values))

        flexible = np.flatnonzero(self.problem.parameters.base.flexible)
        lowest = np.argmin(in_threads(costs, row), axis=0)
        best = {self.names[i]: row[lowest[i]] for i in flexible}
        for name, f in best.items():
            progress(f"{name}: its mode is searched from {f:.3g} Hz")
        return best


def frequency_row(sample_time: float) -> list[float]:
    """Return the trial frequencies of modes, Hz."""
    row = [f for f in _MODES if f < _STIFF / sample_time]
    if not row:
        raise MethodError(
            f"Modes are searched from {_MODES[0]:g} Hz on, which records of {sample_time:g} s a sample do not show; "
            "log faster, or leave the springs out."
        )
    return row


def _mass_matrix(problem: Simulated, numbers: Numbers, pose: FloatArray) -> FloatArray:
    """Return that of a robot of rigid joints, rotors included, (n, n)."""
    from jointid.models.robots.equations import ROOM, equations_of_motion

    still, room = np.zeros(pose.size), np.empty((pose.size, ROOM))
    M = np.empty((pose.size, pose.size))
    equations_of_motion(problem.log.tree, numbers.inertials, pose, still, still, room, M, np.empty(pose.size))
    return M + np.diag([own["inertia"] for own in numbers.values])


def _split(
    parameters: RobotParameters,
    rigid: RobotFit,
    numbers: Numbers,
    wanted: FloatArray,
    spread: FloatArray,
    lightest: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the parameters that move as the rigid robot does with stiff springs, and their rotors, (n,).

    Least squares of what the rigid robot's parameters say, each as well as it is known, and of the wanted rotors with
    their spread, (n,) each; no rotor is lighter than the lightest.
    """
    rotors = wanted.copy()
    known = dict(zip(rigid.parameters.places, rigid.values, strict=True))
    values = np.zeros(len(parameters.places))
    shared = []  # inertias, and constant torques, as which a weight may act
    for c, place in enumerate(parameters.places):
        if place.of_link or place.own in ("inertia", "offset"):
            shared.append(c)
        elif place.name not in ("stiffness", "damping"):
            found_of = {one.name: value for one, value in known.items() if one.axis == place.axis}
            # The link's own friction is the same in both directions.
            ways = [found_of.get(f"viscous_{way}", 0.0) for way in ("forwards", "backwards")]
            whole = found_of.get(place.own, 0.0) + (0.5 * sum(ways) if place.own == "viscous" else 0.0)
            # What rises towards standstill is the motor's.
            halved = numbers.flexible[place.axis] and place.own != "stribeck_force"
            values[c] = 0.5 * whole if halved else whole
    # What each of these is of the rigid robot's: itself if that has it, or else as it groups it.
    kept, dropped = list(rigid.parameters.places), list(rigid.parameters.dropped)
    weights = np.zeros((len(kept), len(shared)))
    began = np.zeros(len(shared))
    for i, c in enumerate(shared):
        place = parameters.places[c]
        if not place.of_link:
            began[i] = wanted[place.axis] if place.own == "inertia" else 0.0
            place = Place(place.axis, place.own)
        if place in kept:
            weights[kept.index(place), i] = 1.0
        else:
            weights[:, i] = rigid.parameters.grouping[:, dropped.index(place)]
    felt = np.any(weights != 0.0, axis=1)
    # What is known of them while the others are free: the end of a triangle that has these last.
    last = np.column_stack([rigid.information[:, ~felt], rigid.information[:, felt]])
    before = int(np.sum(~felt))
    whiten = np.asarray(np.linalg.qr(last, mode="r"))[before:, before:]
    places = [parameters.places[c] for c in shared]
    mine = [i for i, place in enumerate(places) if place.own == "inertia"]
    near = np.zeros((len(mine), len(shared)))
    near[np.arange(len(mine)), mine] = [1.0 / spread[places[i].axis] for i in mine]
    left = rigid.values[felt] - weights[felt] @ began
    rows = np.vstack([whiten @ weights[felt], near])
    norms = column_norms(rows)
    target = np.concatenate([whiten @ left, np.zeros(len(mine))])
    found = began + np.linalg.lstsq(rows / norms, target, rcond=None)[0] / norms
    for i, c in enumerate(shared):
        place = parameters.places[c]
        values[c] = found[i]
        if i in mine and numbers.flexible[place.axis]:
            values[c] = rotors[place.axis] = max(float(found[i]), float(lightest[place.axis]))
    return values, rotors


def bound_springs(problem: Simulated, start: StartOfSprings) -> Simulated:
    """Return the problem with bounds on each spring."""
    lowest, highest = (share / problem.sample_time for share in (_SOFTEST, STIFFEST))

    def within(place: Place, parameter: Parameter) -> Parameter:
        if parameter.quantity is not Quantity.STIFFNESS:
            return parameter
        inertia = float(start.reduced[place.axis])
        ends = [math.log(spring_at(hertz, inertia)["stiffness"]) for hertz in (lowest, highest)]
        return replace(parameter, lower=ends[0], upper=ends[1])

    free = tuple(within(place, one) for place, one in zip(problem.parameters.places, problem.free, strict=True))
    return replace(problem, parameters=replace(problem.parameters, parameters=free))
