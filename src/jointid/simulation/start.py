"""Initial state of a simulation, and its derivatives by parameters.

A joint's motor begins at the given state, or on its reference at rest, and the load hangs on it. At rest the
controllers' torques hold a robot's weight, and friction holds none of it. In motion every shaft has the velocity and
the acceleration of its reference, and the controllers' torques are those of this motion: the reference leads by the
error that causes them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import REFERENCE
from jointid.models.robots.robot import Tree
from jointid.simulation.loop_input import AxisInput, LoopInput
from jointid.simulation.plant import Numbers, Place

INITIAL = ("initial_position", "initial_velocity", "initial_torque")  # of a record's first sample alone

_HARDLY = 0.01  # of the reference's largest speed: at less a friction has not wound up before the first sample
_SETTLING = 200  # of the steps that find where the links hang
_AT_REST = 1e-13  # of a position
_LEAST = 0.5  # of a slope by which Newton's method goes: links that gravity pushes over hang nowhere
_SMALL = 1e-5  # of a number, a position or a speed: differences of what balances at the first sample


@dataclass(frozen=True, slots=True)
class Initial:
    """Initial motor position and velocity; None: on the reference, at rest.

    `torque` is the output of an integral there; None: its content is 0.
    """

    position: float | None = None
    velocity: float | None = None
    torque: float | None = None


class Start(NamedTuple):
    """The first state of a simulation.

    Attributes:
        places, speeds: (masses,) of all masses. wound: (masses,) the share of friction that is wound up, or the
            direction in which each slides.
        torques: (n,) of the motors, without additions behind the limits; None for a controller whose own state
            determines the torque.
        states: (n, states) of the controllers. before: (n,) torques that acted before the first period.
    """

    places: FloatArray
    speeds: FloatArray
    wound: FloatArray
    torques: tuple[float | None, ...]
    states: FloatArray
    before: FloatArray


def begin(experiment: LoopInput, numbers: Numbers, initial: Initial | None = None) -> Start:
    """Initial state: a robot's from its records, a joint's from `initial`."""
    initial = initial or Initial()
    if experiment.tree is not None:
        steady = _steady(experiment, numbers)
        places, load = steady.settle()
        speeds, holding = steady.of_masses(steady.speeds), load - experiment.sampled.post[:, 0]
        wound = np.sign(speeds)
        held = zip(holding, experiment.axes, strict=True)
        torques = tuple(float(torque) if axis.integral is not None else None for torque, axis in held)
    else:
        position = float(experiment.axis.inputs[0, REFERENCE]) if initial.position is None else initial.position
        velocity, torques = initial.velocity or 0.0, (initial.torque,)
        sliding = wound_up(experiment.axis, velocity)
        pulled, places = velocity or numbers.joints[0].forces, np.full(numbers.count, position)
        places = steady_joint(numbers, position, velocity, sliding).settle()[0] if pulled else places
        speeds, wound = np.full(places.size, velocity), np.full(places.size, sliding)
    states, before = np.zeros((len(numbers.joints), experiment.sampled.A.shape[-1])), np.zeros(len(torques))
    for j, (each, motor) in enumerate(zip(experiment.axes, numbers.motors, strict=True)):
        own, first = first_state(each, float(places[motor]), float(speeds[motor]), torques[j])
        states[j, : own.size], before[j] = own, first + each.after_limit[0]
    return Start(places, speeds, wound, torques, states, before)


def first_state(axis: AxisInput, position: float, velocity: float, torque: float | None) -> tuple[FloatArray, float]:
    """Feedback states at the first period, (states,), and the torque before it."""
    law, integral = axis.feedback, axis.integral
    motion = np.array([position, velocity])
    state = axis.state + axis.memory @ motion
    first = float(axis.feedforward[law.output, 0] + law.C[0, law.output] @ axis.state + axis.by_motion @ motion)
    if integral is not None and torque is not None:
        state = state + integral * (torque - first)
        first = torque
    return state, min(max(first, -law.limit), law.limit)


def wound_up(axis: AxisInput, velocity: float) -> float:
    """Direction of a motion before the first sample, 0 if negligible."""
    if velocity == 0.0:
        return 0.0
    reference = axis.inputs[:, REFERENCE]
    fastest = float(np.max(np.abs(np.diff(reference)), initial=0.0)) / axis.law.period
    return math.copysign(1.0, velocity) if abs(velocity) > _HARDLY * fastest > 0.0 else 0.0


def start_slopes(
    experiment: LoopInput, numbers: Numbers, start: Start, keys: Sequence[Place]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Derivatives of places, speeds, (masses, keys), and controller states, (n, states, keys)."""
    if experiment.tree is None:
        steady = steady_joint(numbers, float(start.places[0]), float(start.speeds[0]), float(start.wound[0]))
    else:
        steady = _steady(experiment, numbers)
    dq, torques = steady.slopes(start.places, keys)
    dv, dz = np.zeros_like(dq), np.zeros((*start.states.shape, len(keys)))
    dv[:, [key.name == INITIAL[1] for key in keys]] = 1.0
    if experiment.tree is None:
        torques[:] = [key.name == INITIAL[2] for key in keys]
    for j, (each, motor, torque) in enumerate(zip(experiment.axes, numbers.motors, start.torques, strict=True)):
        by_motion, own = each.memory, dz[j, : len(each.memory)]
        if each.integral is not None and torque is not None:
            by_motion = by_motion - np.outer(each.integral, each.by_motion)
            own += np.outer(each.integral, torques[j])
        own += by_motion @ np.array([dq[motor], dv[motor]])
    return dq, dv, dz


# How springs hang


@dataclass(frozen=True, slots=True, eq=False)
class Steady:
    """Steady motion of a joint or robot at the first driving sample.

    Attributes:
        numbers: of it.
        free: (n,) positions of the motors without a torque.
        speeds, accelerations: (n,) of the shafts.
        tree: of the links; None of a joint, with its weight at rest.
        pushed: (n,) the torques on the motors there.
        soft: (n,) torque per displacement of each from there, negative; minus infinity if it does not give way.
    """

    numbers: Numbers
    free: FloatArray
    speeds: FloatArray
    accelerations: FloatArray
    tree: Tree | None = None
    pushed: FloatArray | float = 0.0
    soft: FloatArray | float = -math.inf

    def of_masses(self, of_shafts: FloatArray) -> FloatArray:
        """Copy values of shafts, (n, ...), to their moving masses, (masses, ...)."""
        found = np.zeros((self.numbers.count, *of_shafts.shape[1:]))
        for own, value in zip(self.numbers.rows, of_shafts, strict=True):
            found[own] = value
        return found

    def settle(self) -> tuple[FloatArray, FloatArray]:
        """Balance by Newton's method: mass positions, (masses,), and motor torques, (n,)."""
        n, at = self.free.size, self.free
        for _ in range(_SETTLING):
            found = self.balance(at)
            missing = at - found[:n]
            if not _AT_REST * (1.0 + float(abs(at).max())) < float(abs(missing).max()) < math.inf:
                break
            slopes = np.eye(n) - self._by_links(at, found)[:n]
            upright = np.min(np.linalg.eigvals(slopes).real) >= _LEAST
            at = at - (np.linalg.solve(slopes, missing) if upright else missing / _LEAST)
        return found[n:-n], found[-n:]

    def slopes(self, places: FloatArray, keys: Sequence[Place]) -> tuple[FloatArray, FloatArray]:
        """Derivatives of positions, (masses, keys), and of motor torques, (n, keys).

        The balance of the links, ``q = G(q, p)``, moves with the numbers by ``dq = (1 - G_q)^-1 G_p``.

        Args:
            places: (masses,) positions in balance.
            keys: parameters.
        """
        n, numbers = self.free.size, self.numbers
        at = places[[own[min(1, len(own) - 1)] for own in numbers.rows]]
        here, by_key = self.balance(at), np.zeros((2 * n + places.size, len(keys)))
        moves = not numbers.straight or numbers.joints[0].forces or np.any(self.speeds)  # else lines leave it there
        for c, key in enumerate(keys):
            if key.name == INITIAL[0]:
                by_key[:-n, c] = 1.0
            elif moved := self._moved(key) if moves or key.name == INITIAL[1] else None:
                by_key[:, c] = (moved[0].balance(at) - here) / moved[1]
        if not np.any(by_key) or (self.tree is None and not numbers.joints[0].forces):
            return by_key[n:-n], by_key[-n:]
        by_links = self._by_links(at, here)
        whole = by_key + by_links @ np.linalg.solve(np.eye(n) - by_links[:n], by_key[:n])
        return whole[n:-n], whole[-n:]

    def _moved(self, key: Place) -> tuple[Steady, float] | None:
        """Perturb a parameter: another motion and the difference, or None."""
        if key.name == INITIAL[1]:  # at rest the drag of steady motion jumps
            width = float(_SMALL * self.speeds[key.axis])
            return (replace(self, speeds=self.speeds * (1.0 + _SMALL)), width) if width else None
        still = () if np.any(self.speeds) else ("viscous", "coulomb")  # at rest friction holds none of the load
        if key not in self.numbers or key.own.startswith(("swinging_", *still)):  # what swings begins with the load
            return None
        value = float(self.numbers[key])
        step = _SMALL * (abs(value) or 1.0)
        return replace(self, numbers=self.numbers.with_values([key], [value + step])), step

    def _by_links(self, at: FloatArray, here: FloatArray) -> FloatArray:
        """Return the derivatives of `balance`, which is `here`, by the links' positions, (..., n)."""
        steps = _SMALL * np.diag(1.0 + np.abs(at))
        return np.column_stack([(self.balance(at + one) - here) / np.max(one) for one in steps])

    def balance(self, at: FloatArray) -> FloatArray:
        """Link positions, (n,), mass positions and motor torques, (n,), in a row.

        Friction may grow with the load. At rest it could carry any part of a load up to its own size, and is assumed to
        carry none.

        Args:
            at: (n,) the links' positions, for their weight.
        """
        weights, deflections = self._weigh(at), np.zeros(at.size)
        for j, (joint, values) in enumerate(zip(self.numbers.joints, self.numbers.values, strict=True)):
            (motor, *behind), speed, torque = joint.sides, float(self.speeds[j]), float(weights[j])
            if behind:
                torque += values.get("load_offset", 0.0) if speed else 0.0  # a part of its friction
                torque += joint.friction.drag(values, speed, torque, "load_")
                deflections[j] = joint.springs[0].deflection(values, torque) if torque else 0.0
            torque += values[f"{motor}inertia"] * float(self.accelerations[j]) + values["offset"]
            weights[j] = torque + joint.friction.drag(values, speed, torque, motor)
        motors = self.free + (weights - self.pushed) / self.soft
        found = self.of_masses(motors - deflections)
        found[self.numbers.motors] = motors
        return np.concatenate([motors - deflections, found, weights])

    def _weigh(self, at: FloatArray) -> FloatArray:
        """Torques of links, or of the load, behind the springs, (n,)."""
        numbers, n = self.numbers, at.size
        taken = np.zeros(n)
        if self.tree is None:
            joint, values = numbers.joints[0], numbers.values[0]
            for side, force in joint.forces if len(joint.sides) > 1 else ():
                taken += force.columns(at) @ [values[p.name] for p in force.parameters] if side else 0.0
            return taken
        from jointid.models.robots.equations import ROOM, equations_of_motion

        M, room = np.empty((n, n)), np.empty((n, ROOM))
        equations_of_motion(self.tree, numbers.inertials, at, self.speeds, self.accelerations, room, M, taken, False)
        return taken


def steady_joint(numbers: Numbers, position: float, velocity: float, sliding: float) -> Steady:
    """Joint at rest or in steady motion; unwound presliding friction is 0."""
    speed = velocity if sliding or not numbers.joints[0].stepped else 0.0
    return Steady(numbers, np.array([position]), np.array([speed]), np.zeros(1))


def _steady(experiment: LoopInput, numbers: Numbers) -> Steady:
    """Steady state of a robot at the start of its records.

    A law with an integral holds the load on the reference; one without is off by the torque over its gain. Springs are
    stretched by the load.
    """
    references = np.array([each.inputs[0, REFERENCE] for each in experiment.axes])
    torques, soft = np.zeros((2, references.size))
    for j, (each, place, speed) in enumerate(zip(experiment.axes, references, experiment.speeds, strict=True)):
        torques[j], slope = first_state(each, float(place), float(speed), None)[1], float(each.by_motion[0])
        gives = each.integral is None and slope < 0.0 and abs(torques[j]) < each.feedback.limit
        soft[j] = slope if gives else -math.inf
    pushed = torques + experiment.sampled.post[:, 0]
    return Steady(numbers, references, experiment.speeds, experiment.accelerations, experiment.tree, pushed, soft)
