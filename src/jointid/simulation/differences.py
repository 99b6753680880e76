"""Derivatives of a closed loop by central differences of whole runs, where its joint has smooth laws.

Such a run is integrated in steps (`simulation.kernels.stepped_drive`), and there is no tape of affine maps to follow.
A difference has an error of second order in its step. The step is small enough for a search and its intervals, and
large beside the error of the integration. The runs go on all cores.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.models.controllers import REFERENCE, SampledLaw, number, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.simulation.closed_loop import ClosedLoopRun, Initial, Outcome, Response, in_threads, run, wound_up
from jointid.simulation.loop_input import LoopInput

_STEP = 3e-4  # of a value, or of a small one's size in this motion
_SMALL = 1e-2  # of that size: what a value below it is stepped by a share of
_BEGINS, _BEGINS_AT = 1e-7, 1e-6  # of travel and of speed: the motor's start is moved by less than friction holds
_FROM_NOTHING = 1e-2  # the step from a number of the controller that is 0, to its right alone: of a delay in periods


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """A run and its derivatives, in the order of the names asked for.

    Attributes:
        response: of the loop.
        torque: (samples, names) of the torque as the log shows it.
        motor_position, load_position: (samples, names); empty where positions were not asked for, the second also for a
            rigid joint.
    """

    response: Response
    torque: FloatArray
    motor_position: FloatArray
    load_position: FloatArray


def none(response: Response, count: int, positions: bool, flexible: bool) -> Sensitivities:
    """Return derivatives of 0."""
    torque = np.zeros((response.torque.size, count))
    position = torque if positions else torque[:, :0]
    return Sensitivities(response, torque, position, position if flexible else torque[:, :0])


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """What a run is made of."""

    loop: ClosedLoop
    experiment: LoopInput
    values: Mapping[str, float]
    initial: Initial

    def moved(self, name: str, by: float) -> _Point:
        """Return the point with one number larger by so much."""
        own = {p.name for p in self.loop.joint.parameters}
        if name in own:
            return replace(self, values={**self.values, name: self.values[name] + by})
        if name.startswith("initial_"):
            word = name.removeprefix("initial_")
            return replace(self, initial=replace(self.initial, **{word: getattr(self.initial, word) + by}))
        controller = with_numbers(self.loop.controller, {name: number(self.loop.controller, name) + by})
        experiment = self.experiment.with_law(self.experiment.law_of(controller))
        return replace(self, loop=replace(self.loop, controller=controller), experiment=experiment)

    def run(self, keep: bool) -> ClosedLoopRun:
        """Return its run."""
        return run(self.loop, self.experiment, self.values, self.initial, keep=keep)


def differences(
    loop: ClosedLoop,
    experiment: LoopInput,
    values: Mapping[str, float],
    names: Sequence[str],
    initial: Initial | None = None,
    *,
    positions: bool = False,
) -> tuple[ClosedLoopRun, Sensitivities]:
    """Return one candidate's run and its derivatives by the parameters named; see `simulate_sensitivities`.

    The derivative by the initial torque is 0 where that is not said, as the law's integral then begins at 0.

    Raises:
        MethodError: a name is none that can be free.
    """
    given = initial or Initial()
    base = run(loop, experiment, values, given, keep=True)
    response, flexible = base.response(), loop.joint.model == "flexible"
    if base.outcome is not Outcome.FINISHED:
        return base, none(response, len(names), positions, flexible)
    position = float(experiment.inputs[0, REFERENCE]) if given.position is None else given.position
    velocity = given.velocity or 0.0
    begun = (
        wound_up(experiment, velocity) if given.wound_up is None else given.wound_up
    )  # its neighbours begin as it does
    started = replace(given, position=position, velocity=velocity, wound_up=begun)
    point, sizes = _Point(loop, experiment, values, started), _Sizes.of(base)

    def slope(name: str) -> tuple[FloatArray, FloatArray]:
        steps = sizes.steps(point, name)
        ends = [point.moved(name, by).run(positions) for by in steps if steps[1] > steps[0]]
        if not ends or any(end.outcome is not Outcome.FINISHED for end in ends):
            return np.zeros(response.torque.size), np.zeros((2, response.torque.size if positions else 0))
        low, high = (end.response().torque for end in ends)
        below, above = (end.states[experiment.looked if positions else slice(0), ::2].T for end in ends)
        width = steps[1] - steps[0]
        return (high - low) / width, (above - below) / width

    found = in_threads(slope, names)
    torque = np.column_stack([np.zeros((response.torque.size, 0)), *(one for one, _ in found)])
    empty = np.zeros((2, response.torque.size if positions else 0, 0))
    moved = np.concatenate([empty, *(states[:, :, np.newaxis] for _, states in found)], axis=2)
    return base, Sensitivities(response, torque, moved[0], moved[1] if flexible else moved[1, :, :0])


def require_same_structure(low: SampledLaw, high: SampledLaw, name: str) -> None:
    """Raise a `MethodError` if what a number of the controller belongs to is not there, such as an integral."""
    if high.limits.size != low.limits.size or (high.integral() is None) != (low.integral() is None):
        raise MethodError(
            f"The {name} of this controller is 0, and what it belongs to is not there, so it has no derivative; "
            "declare another."
        )


@dataclass(frozen=True, slots=True)
class _Sizes:
    """How large the torque and the motion of a run are: what small values are measured against."""

    torque: float
    travel: float
    speed: float
    windup: float

    @classmethod
    def of(cls, base: ClosedLoopRun) -> _Sizes:
        """Return the sizes of a run whose states were kept."""
        least = np.finfo(float).tiny
        states = base.states
        windup = float(np.max(np.abs(states[:, 2] - states[:, 0]))) if base.loop.joint.model == "flexible" else 1.0
        return cls(
            float(np.max(np.abs(base.command))) or 1.0, float(np.ptp(states[:, 0])) or 1.0,
            max(float(np.max(np.abs(states[:, 1]))), least), max(windup, least),
        )  # fmt: skip

    def of_joint(self, p: Parameter) -> float:
        """Return the size of a parameter that matters in this motion."""
        return {
            Quantity.FORCE: self.torque,
            Quantity.VISCOUS: self.torque / self.speed,
            Quantity.STIFFNESS: self.torque / self.windup,
            Quantity.CUBIC_STIFFNESS: self.torque / self.windup**3,
            Quantity.FORCE_RATE: self.torque / self.travel,
            Quantity.VISCOUS_DRIFT: self.torque / self.speed,
            Quantity.FORCE_DRIFT: self.torque,
            Quantity.RATIO: 1.0,
        }.get(p.quantity, 0.0)

    def steps(self, point: _Point, name: str) -> tuple[float, float]:
        """Return by how much a number is moved, down and up; nothing where its derivative is 0."""
        by_name = {p.name: p for p in point.loop.joint.parameters}
        if name in by_name:
            p, value = by_name[name], point.values[name]
            step = _STEP * max(abs(value), _SMALL * self.of_joint(p))
            # At a bound, such as 0, the derivative is that to the side where there are joints.
            return (-step if value - step >= p.lower else 0.0), (step if value + step <= p.upper else 0.0)
        if name == "initial_torque":
            step = 0.0 if point.initial.torque is None else _STEP * self.torque
            return -step, step
        if name.startswith("initial_"):
            step = _BEGINS_AT * self.speed if name.endswith("velocity") else _BEGINS * self.travel
            return -step, step
        controller, period = point.loop.controller, point.experiment.law.period
        value = number(controller, name)
        if not math.isfinite(value):  # a limit that never acts
            return 0.0, 0.0
        if value:
            return -_STEP * abs(value), _STEP * abs(value)
        step = _FROM_NOTHING * (period if name.endswith("delay") else 1.0)
        laws = [point.moved(name, by).experiment.law for by in (0.0, step)]
        require_same_structure(laws[0], laws[1], name)
        return 0.0, step
