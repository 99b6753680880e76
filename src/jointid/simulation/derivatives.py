"""Parameter derivatives of a run: by variation, or columns of known motion.

They are of order 2 in the steps of the tape, of order 4 where a joint's equations are linear (`kernels.variation`), and
exact where a map crosses a part. Derivatives by a controller's numbers are exact, too: the law, linear in its signals,
is run on the simulated position at two neighbouring values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, Room
from jointid.common.errors import MethodError
from jointid.common.parallel import in_threads
from jointid.models.controllers import number, respond, with_numbers
from jointid.models.controllers import run as run_law
from jointid.models.friction import KNOTS
from jointid.models.joints import Joint
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Tree
from jointid.records.record import Tap, Timing
from jointid.simulation import kernels
from jointid.simulation.kernels import LANES, IntArray, Seeds
from jointid.simulation.loop_input import AxisInput, acting, along, averages, to_log
from jointid.simulation.plant import DELAY, OF_RECORD, Numbers, Place
from jointid.simulation.simulate import MassMotion, Outcome, Run, motion_at
from jointid.simulation.start import INITIAL, start_slopes

_STEP = 1e-4  # of a controller's number: its output is a low-order polynomial in it
_FROM_NOTHING = 1e-2  # the step from a number that is 0, to its right alone: of a delay in periods; the law is linear
_ASTRAY = 1e100  # a derivative by which two neighbours part at once; its square would be no number
_AT_ONCE = 256  # samples of a regressor, which is much larger than what is taken of it
_NOBODY = Place(0, "")  # of what nothing depends on
_ROOM = Room()


def differentiate(kept: Run, keys: Sequence[Place], *, positions: bool = False) -> tuple[list[FloatArray], FloatArray]:
    """Derivatives of the logged torques, by axis, (samples, keys), and of positions.

    At a delay of whole periods the derivative is one-sided, towards longer delays; at rest, that by the motor's
    velocity includes a load that moves along.

    Args:
        kept: run with its tape. If it failed, or diverged at a torque limit (above 1e100), all derivatives are 0.
        keys: parameters: numbers of joint or robot, "delay" of a torque, and of a joint alone "initial_position",
            "initial_velocity", "initial_torque" or numbers of its controller ("position_gain", "limit",
            "velocity_filter.time_constant", ...).
        positions: of a joint's motor and load, (samples, masses, keys); else (samples, 0, keys).
    """
    experiment, clock = kept.experiment, kept.experiment.clock
    shown = min(kept.start.places.size, 2) if positions else 0
    torques = [np.empty((clock.samples, len(keys))) for _ in experiment.axes]
    moved = np.empty((clock.samples, shown, len(keys)))
    if kept.outcome is not Outcome.FINISHED:
        return [np.zeros_like(one) for one in torques], np.zeros_like(moved)
    wide = LANES if kept.path is not None else -(-max(len(keys), 1) // LANES) * LANES  # rows in whole vectors
    filled = (*keys, *[_NOBODY] * (-len(keys) % wide if keys else wide))
    first_slopes = start_slopes(experiment, kept.carried, kept.start, filled)
    for first in range(0, len(filled), wide):
        some, last = keys[first : first + wide], min(first + wide, len(keys))
        begun = [one[..., first : first + wide].copy() for one in first_slopes]
        of_law = [c for c, key in enumerate(some) if key not in kept.numbers and key.name not in (*INITIAL, DELAY)]
        explicit = [(c, some[c].axis, *_explicit(kept, some[c])) for c in of_law]
        command, states = _follow(kept, filled[first : first + wide], begun, explicit, positions)
        for j, (torque, each) in enumerate(zip(torques, command, strict=True)):
            torque[:, first:last] = _show(kept, j, each[:, : len(some)], some)
        if shown:
            moved[..., first:last] = states[clock.log_index, : 2 * shown : 2, : len(some)]
    if experiment.tree is None and not np.vdot(torques[0], torques[0]) < _ASTRAY**2:
        return [np.zeros_like(torques[0])], np.zeros_like(moved)
    return torques, moved


def respond_to_laws(kept: Run, changes: Sequence[tuple[int, AxisInput]]) -> tuple[list[FloatArray], list[FloatArray]]:
    """First-order changes of a run's logged torques under other laws.

    Another law, an axis and its input with the period of its own law and up to a period more delay, outputs another
    torque for the motion of a run with its tape. The loops respond to this difference as in their derivatives.

    Returns:
        Of each axis what its own law adds as the motion changes, (samples, changes); of each change the difference of
        the two laws along the motion of the run, (samples,).
    """
    experiment, clock, count = kept.experiment, kept.experiment.clock, len(changes)
    position = motion_at(kept, clock.lengths.size * np.arange(clock.steps)).position[:, kept.numbers.motors]
    explicit, direct = list[tuple[int, int, FloatArray, FloatArray]](), list[FloatArray]()
    for column, (j, other) in enumerate(changes):
        own = experiment.axes[j]
        path, speed, law = clock.own(j, position[:, j], own.periods), float(experiment.speeds[j]), own.law
        before, after = (run_law(one.law, *along(one.law, one.inputs, path, speed)) for one in (own, other))
        late, acts = (other.law.delay - law.delay) / law.period, after + own.after_limit
        pushed = (1.0 - late) * acts + late * np.append(acts[0], acts[:-1]) - own.after_limit - before
        of_output = np.arange(law.limits.size) == law.output
        explicit.append((column, j, np.outer(pushed, of_output), np.zeros(law.limits.size)))
        shown = (to_log(one, of + one.shown) for one, of in ((own, before), (other, after)))
        direct.append(-np.subtract(*shown)[: clock.samples])
    width = LANES if kept.path is not None else count
    still = np.zeros((kept.start.places.size, width))
    states = np.zeros((len(experiment.axes), kept.start.states.shape[1], width))
    command, _ = _follow(kept, (), (still, still, states), explicit)
    for column, j, pushed, _ in explicit:
        command[j, :, column] -= clock.repeat(j, pushed @ np.ones(pushed.shape[1]))
    return [_show(kept, j, command[j, :, :count], ()).copy() for j in range(len(experiment.axes))], direct


def _show(kept: Run, j: int, command: FloatArray, keys: Sequence[Place]) -> FloatArray:
    """Derivatives of an axis's logged torque, (samples, keys), from (steps, keys)."""
    axis, clock = kept.experiment.axes[j], kept.experiment.clock
    logged = to_log(axis, clock.own(j, command, axis.periods))
    late = [c for c, key in enumerate(keys) if key == (j, DELAY)]
    if late and axis.tap is Tap.MEASURED and axis.timing is Timing.AVERAGED:
        # An edge that moves takes its height from the mean over the sample time it stands in.
        torque = acting(axis, clock.own(j, kept.command[j], axis.periods) + axis.shown)
        logged[:, late] += averages(axis, -np.diff(torque, prepend=kept.start.before[j]))[:, np.newaxis]
    return logged[: clock.samples]


def _follow(
    kept: Run, keys: Sequence[Place], first: Sequence[FloatArray],
    explicit: Sequence[tuple[int, int, FloatArray, FloatArray]], positions: bool = False,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Derivatives of outputs, (n, steps, keys), and states, (parts, 4, keys).

    Args:
        kept: run with its tape.
        keys: of numbers of the plant.
        first: derivatives of the first state by `keys` and the explicit columns, see `start_slopes`.
        explicit: column and axis of each number of a law, and its result of `_explicit`.
        positions: also compute the derivatives of the states.
    """
    experiment, clock, numbers = kept.experiment, kept.experiment.clock, kept.carried
    (n, elements, _), width = experiment.sampled.w.shape, first[0].shape[1]
    command = _ROOM.array("command", (n, clock.steps, width))
    rows = clock.steps * clock.lengths.size if positions else 0
    states = _ROOM.array("moved", (rows, 4, width))
    limits = np.zeros((n, elements, width))
    of_law = np.zeros((n, experiment.sampled.w.shape[2] if explicit else 0, elements, len(explicit)))
    for c, (column, j, of_elements, of_limits) in enumerate(explicit):
        own = of_limits.size
        of_law[j, : len(of_elements), :own, c], limits[j, :own, column] = of_elements, of_limits
    (places, speeds, laws), alone = first, kept.path is None and experiment.tree is None
    lines = not alone and all(law.linear for joint in numbers.joints for law in joint.laws)
    names, links = tuple(map(tuple, numbers.values)), len(numbers.inertials)
    seeds = _seeds_of_lines(numbers.joints, names, links, tuple(keys)) if lines else numbers.seeds(kept.plant, keys)
    from jointid.simulation.kernels.variation import follow

    wound = np.zeros((1, kernels.MASS + 2), np.complex128) if kept.path is None else None
    follow(
        kept.plant, experiment.tree, numbers.inertials, experiment.sampled, (0.0,) * numbers.count if alone else None,
        kept.start.before, kept.command, kept.excess, kept.tape, kept.path, wound, seeds, places, speeds, laws,
        of_law, np.array([column for column, *_ in explicit], dtype=np.int64), limits, command, states, command[:, :0],
    )  # fmt: skip
    return command, states


@lru_cache(maxsize=64)
def _seeds_of_lines(
    joints: tuple[Joint, ...], names: tuple[tuple[str, ...], ...], links: int, keys: tuple[Place, ...]
) -> Seeds:
    """Dependence of a plant of lines on parameters, the same everywhere."""
    numbers = Numbers(joints, tuple(dict.fromkeys(own, 1.0) for own in names), np.zeros((links, 10)))
    return numbers.seeds(numbers.plant, keys)


def _explicit(kept: Run, key: Place) -> tuple[FloatArray, FloatArray]:
    """Derivatives of an axis's elements, (periods, elements), and limits by its number.

    Position, and excesses of limits and gates, are held.
    """
    (j, name), clock = key, kept.experiment.clock
    axis, motor = kept.experiment.axes[j], kept.numbers.motors[j]
    value = number(axis.controller, name)
    if not math.isfinite(value):  # a limit that never acts
        return np.zeros((axis.periods, axis.law.limits.size)), np.zeros(axis.law.limits.size)
    unit = axis.law.period if name.endswith("delay") else 1.0
    steps = (-_STEP * abs(value), _STEP * abs(value)) if value else (0.0, _FROM_NOTHING * unit)
    position = motion_at(kept, clock.lengths.size * np.arange(clock.steps)).position[:, motor]
    low, high = (axis.law_of(with_numbers(axis.controller, {name: value + by})) for by in steps)
    if high.limits.size != low.limits.size or (high.integral() is None) != (low.integral() is None):
        raise MethodError(
            f"The {name} of this controller is 0, and what it belongs to is not there, so it has no derivative; "
            "declare another."
        )
    held, width = np.asarray(kept.excess[j, : axis.periods, : low.limits.size]), steps[1] - steps[0]
    seen, speed, torque = clock.own(j, position, axis.periods), float(kept.start.speeds[motor]), kept.start.torques[j]
    found = []
    for law in (low, high):
        inputs, state = along(law, axis.inputs, seen, speed)
        integral = law.integral()
        if integral is not None and torque is not None:
            state = state + integral * (torque - law.C[0, law.output] @ state - law.D[0, law.output] @ inputs[0])
        found.append(respond(law, inputs, state, held))
    with np.errstate(invalid="ignore"):
        limits = np.where(np.isinf(low.limits), 0.0, (high.limits - low.limits) / width)
    return (found[1] - found[0]) / width, limits


# Columns of a known motion


def columns_of(
    tree: Tree | None, numbers: Numbers, places: Sequence[Place], motion: MassMotion, rows: Sequence[int]
) -> list[tuple[IntArray, FloatArray]]:
    """Derivatives of each mass's equation by the parameters that act in it.

    These are the regressor's columns at a known motion. Their product with the parameters is the motor's torque, and
    0 for the link of a flexible joint. Each has the indices of its parameters, (own,), and their columns,
    (samples, own), contiguous in memory.
    Of the numbers only laws and Stribeck speeds are read.
    """
    from jointid.models.robots.dynamics import regressor_of

    samples, of_axes = len(motion.position), numbers.rows
    n = len(of_axes)
    carried = np.eye(n, dtype=np.bool_) if tree is None else _find_carriers(tree)
    felt = [np.array([c for c, p in enumerate(places) if _acts(p, row, of_axes, carried)], int) for row in rows]
    ends = np.cumsum([own.size for own in felt])
    lines, of_links = np.empty((int(ends[-1]), samples)), []
    for row, own, end in zip(rows, felt, ends, strict=True):
        for line, place in zip(range(int(end) - own.size, int(end)), (places[c] for c in own), strict=True):
            if place.of_link:
                of_links.append((row, len(SYMBOLS) * place.axis + place.column, line))
            elif place.name in ("stiffness", "damping"):
                motor, link = of_axes[place.axis]
                moved = motion.position if place.name == "stiffness" else motion.velocity
                stretch = moved[:, motor] - moved[:, link]
                lines[line] = stretch if row == motor else -stretch
            else:
                lines[line] = mass_column(place, numbers, *(one[:, row] for one in motion))
    if of_links:
        assert tree is not None
        whose, which, where = np.array(of_links).T
        joints = tree.joints if tree.joints.size else np.eye(n)
        of_joints = [np.ascontiguousarray(values[:, :n] @ joints.T) for values in motion[:3]]

        def fill(first: int) -> None:
            inside = slice(first, first + _AT_ONCE)
            Y = regressor_of(tree, *(one[inside] for one in of_joints))
            Y = joints.T @ Y if tree.joints.size else Y
            lines[where, inside] = Y[:, whose, which].T

        in_threads(fill, range(0, samples, _AT_ONCE))
    return [(own, lines[end - own.size : end].T) for own, end in zip(felt, ends, strict=True)]


def _find_carriers(tree: Tree) -> NDArray[np.bool_]:
    """Matrix, (n, n), True where a link carries another; all when coupled."""
    if tree.joints.size:
        return np.ones(tree.joints.shape, dtype=np.bool_)
    found = np.eye(tree.parents.size, dtype=np.bool_)
    for i, parent in enumerate(tree.parents):
        if parent >= 0:
            found[:, i] |= found[:, parent]
    return found


def _acts(place: Place, row: int, of_axes: list[list[int]], carried: NDArray[np.bool_]) -> bool:
    """True of a parameter that is in the equation of a mass."""
    if place.of_link:
        return row < len(carried) and bool(carried[row, place.axis])
    if place.name in OF_RECORD or row not in of_axes[place.axis]:
        return False
    behind, own = place.side == "load_" or place.name.startswith(("gravity_", "counterbalance_")), of_axes[place.axis]
    return place.name in ("stiffness", "damping") or row == own[min(int(behind), len(own) - 1)]


def mass_column(
    place: Place, numbers: Numbers, position: FloatArray, velocity: FloatArray, acceleration: FloatArray,
    direction: FloatArray,
) -> FloatArray:  # fmt: skip
    """Regressor column of a mass's number along a motion, (samples,)."""
    own = place.own
    known = {"inertia": acceleration, "viscous": velocity, "coulomb": direction, "offset": np.ones_like(velocity)}
    if own in known:
        return known[own]
    if own == "stribeck_force":
        below = numbers.values[place.axis][f"{place.side}stribeck_speed"]
        share = np.interp(np.abs(velocity) / below, *np.transpose(KNOTS)) if below > 0.0 else 0.0
        return np.asarray(direction * share)
    if own.startswith(("viscous_", "coulomb_")) and own.endswith(("forwards", "backwards")):
        way = 1.0 if own.endswith("forwards") else -1.0
        clip = np.maximum if way > 0.0 else np.minimum
        return np.asarray(clip(velocity, 0.0) if own.startswith("viscous") else 0.5 * (way + direction))
    for _, force in numbers.joints[place.axis].forces:
        names = [p.name for p in force.parameters]
        if place.name in names:
            return np.asarray(force.columns(position)[:, names.index(place.name)])
    raise NotImplementedError(f"the equations are not linear in {place.name}")
