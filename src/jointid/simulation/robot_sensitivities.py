"""Derivatives of a robot's torques by its parameters: by variation of a run, or as columns at a known motion.

The variation is that of `kernels.robot_variation`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.parallel import in_threads, threads
from jointid.models.controllers import POSITION
from jointid.models.controllers import run as run_law
from jointid.models.controllers.sampled import LawRun
from jointid.models.robots.dynamics import IntArray
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.robots.robot import Tree
from jointid.records.record import Tap, Timing
from jointid.simulation.closed_loop import first_state
from jointid.simulation.loop_input import LoopInput, acting, averages, seen_torque, to_log
from jointid.simulation.plant import IMAGINARY, slope
from jointid.simulation.robot_numbers import (
    MassNumbers,
    NumberOf,
    NumberPlace,
    RobotNumbers,
    mass_of,
    spring_of,
    stribeck_share,
    with_values,
)
from jointid.simulation.robot_start import (
    FirstSample,
    controllers_at,
    deflections,
    friction_at,
    link_torques,
    own_torques,
    speeds_at_start,
    spring_torques,
)
from jointid.simulation.robots import MassMotion, RobotRun, motion_at

if TYPE_CHECKING:
    from jointid.simulation.kernels.robot_variation import Moved, Seeds

_RELATIVE = 1e-6  # of a number, or of 1 where that is more: differences of laws
_SMALL = 1e-7  # rad: differences of the load
_NUDGE = 1e-3  # rad: differences of a controller's state, which is linear


def differentiate_torques(run: RobotRun, places: tuple[NumberPlace, ...]) -> list[FloatArray]:
    """Return the derivatives of the torques as the log shows them, by joint, (samples, parameters) each.

    Args:
        run: that finished, and whose tape was kept.
        places: of the parameters.

    Of order 2 in the pieces of the tape: against differences of whole runs some 1e-3 of the largest.
    """
    return _follow(run, places, _at_start(run, places))


def respond_to_laws(
    run: RobotRun, changes: Sequence[tuple[int, LoopInput]]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return by how much other laws change a run's torques, to first order, as the log shows them.

    A law of a joint that reads the motion of the run outputs another torque than that of the run. The response of the
    loops to this difference is that of their derivatives.

    Args:
        run: that finished, and whose tape was kept.
        changes: joint and input of each other law, of the period of its own, and later by a period at most.

    Returns:
        Of each joint what its own law adds as the motion changes, (samples, changes); of each change the difference of
        the two laws along the motion of the run, (samples,).
    """
    from jointid.simulation.kernels.robot_variation import Moved

    clock, n, count = run.experiment.clock, run.numbers.rotors.size, len(changes)
    position = motion_at(run, clock.lengths.size * np.arange(clock.steps)).position[:, run.numbers.rotors]
    pushes, direct = np.zeros((count, clock.steps)), list[FloatArray]()
    for push, (j, other) in zip(pushes, changes, strict=True):
        own = run.experiment.experiments[j]
        path, speed = clock.own(j, position[:, j], own.periods), float(run.experiment.speeds[j])
        before, after = (_run_law(one, path, speed) for one in (own, other))
        late = (other.law.delay - own.law.delay) / own.law.period
        acts = (1.0 - late) * after.output + late * np.append(after.output[0], after.output[:-1])
        push[:] = clock.repeat(j, acts - before.output)
        shown = (to_log(one, seen_torque(one, of.output)) for one, of in ((own, before), (other, after)))
        direct.append(-np.subtract(*shown)[: clock.samples])
    places = tuple(NumberPlace(NumberOf.PUSH, j, i) for i, (j, _) in enumerate(changes))
    still, states = np.zeros((len(run.numbers.masses), count)), run.experiment.sampled.feedback.A.shape[-1]
    moved = Moved(still, still.copy(), np.zeros((n, states, count)), np.zeros((n, count)))
    return _follow(run, places, moved, pushes), direct


def _run_law(experiment: LoopInput, position: FloatArray, speed: float) -> LawRun:
    """Return a law's run along a motor position, (periods,), that begins at a speed."""
    law, inputs = experiment.law, experiment.inputs.copy()
    inputs[:, POSITION] = position
    return run_law(law, inputs, law.known_memory(inputs) + law.memory(POSITION, float(position[0]), speed))


def _follow(
    run: RobotRun, places: tuple[NumberPlace, ...], moved: Moved, pushes: FloatArray | None = None
) -> list[FloatArray]:
    """Return the derivatives of the torques as the log shows them, by joint, (samples, parameters) each.

    Pushes, (pushes, clock), are torques added to controllers' outputs; in the result they are left out.
    """
    from jointid.simulation.kernels import robot_variation as kernels

    experiment, clock, numbers = run.experiment, run.experiment.clock, run.experiment.carrying(run.numbers)
    rows = rows_of(run.numbers, places)
    command = np.zeros((len(experiment.experiments), clock.steps, len(rows)))
    seeds = seeds_of(run.numbers, places)
    seeds = seeds if pushes is None else seeds._replace(pushes=pushes)
    kernels.differentiate_run(
        experiment.tree, numbers.inertials, numbers.plant, experiment.sampled, run.before, run.command, run.excess,
        run.tape, rows, seeds, moved, command, np.zeros((len(command), 0, 0)),
    )  # fmt: skip
    for c, (kind, j, push) in enumerate(rows):
        if kind == NumberOf.PUSH:
            command[j, :, c] -= seeds.pushes[push]
    found = []
    for j, each in enumerate(experiment.experiments):
        logged = to_log(each, clock.own(j, command[j], each.periods))
        late = np.flatnonzero((rows[:, 0] == NumberOf.DELAY) & (rows[:, 1] == j))
        if late.size and each.tap is Tap.MEASURED and each.timing is Timing.AVERAGED:
            # An edge that moves takes its height from the mean over the sample time it stands in.
            torque = acting(each, seen_torque(each, clock.own(j, run.command[j], each.periods)))
            edges = -np.diff(torque, prepend=torque[0])
            logged[:, late] += averages(each, edges)[:, np.newaxis]
        found.append(logged[: clock.samples])
    return found


def rows_of(numbers: RobotNumbers, places: Sequence[NumberPlace]) -> IntArray:
    """Return of each parameter the array of the kernels, its row and its column."""
    spring = np.cumsum(numbers.flexible) - 1
    found = [(p.of, spring[p.row] if p.of is NumberOf.SPRING else p.row, p.column) for p in places]
    return np.array(found, dtype=np.int64).reshape(-1, 3)


def seeds_of(numbers: RobotNumbers, places: Sequence[NumberPlace]) -> Seeds:
    """Return how the numbers that the kernels read depend on parameters, by a complex step: rational functions."""
    from jointid.simulation.kernels.robot_variation import Seeds

    plant = numbers.plant
    masses = np.zeros((len(places), *plant.masses.shape[1:]))
    springs = np.zeros((len(places), *plant.springs.shape[1:]))
    for c, place in enumerate(places):
        if place.of not in (NumberOf.MASS, NumberOf.SPRING):
            continue
        row = numbers.arrays[place.of][place.row].astype(np.complex128)
        row[place.column] += 1j * IMAGINARY
        of_mass = place.of is NumberOf.MASS
        own = mass_of(row, numbers.frictions[place.row]) if of_mass else spring_of(row, numbers.laws[place.row][1])
        (masses if of_mass else springs)[c, : len(own)] = slope(own)
    return Seeds(masses, springs, np.zeros((0, 0)))


def _at_start(run: RobotRun, places: tuple[NumberPlace, ...]) -> Moved:
    """Return the derivatives at the first sample.

    Of `robot_start.begin`: ``load(q) + own = torque(qm)`` where the law has no integral, ``qm`` the reference where it
    has; ``K (qm - q) = load(q)``.
    """
    from jointid.simulation.kernels.robot_variation import Moved

    experiment, numbers = run.experiment, run.experiment.carrying(run.numbers)
    n, rotors = numbers.rotors.size, numbers.rotors
    motors, speeds = run.start[rotors], experiment.speeds
    integrates = np.array([each.integral is not None for each in experiment.experiments])
    states = np.zeros((n, experiment.sampled.feedback.A.shape[-1], 3))  # at the start, further, with more torque
    for j, each in enumerate(experiment.experiments):
        for i, (at, torque) in enumerate(((0.0, 0.0), (_NUDGE, 0.0), (0.0, 1.0))):
            state, _ = first_state(each, motors[j] + at, speeds[j], torque if integrates[j] else None)
            states[j, : state.size, i] = state
    steep = controllers_at(experiment, motors)[1]
    soft = np.where(integrates | (steep >= 0.0), 0.0, 1.0 / np.where(steep == 0.0, -1.0, steep))
    dq, load = slopes_at_start(experiment, numbers, run.start, soft, places)
    of_motor = dq[rotors]
    by_place, by_torque = (states[:, :, 1] - states[:, :, 0]) / _NUDGE, states[:, :, 2] - states[:, :, 0]
    dz = by_place[:, :, np.newaxis] * of_motor[:, np.newaxis]
    dz += by_torque[:, :, np.newaxis] * np.where(integrates[:, np.newaxis], load, 0.0)[:, np.newaxis]
    return Moved(dq, np.zeros_like(dq), dz, load)


def slopes_at_start(
    first: FirstSample, numbers: RobotNumbers, start: FloatArray, soft: FloatArray, places: tuple[NumberPlace, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the positions in steady motion, and of the motors' torques there.

    Args:
        first: how the robot moves.
        numbers: of the robot.
        start: (masses,) positions.
        soft: (n,) how far a torque of 1 moves each motor; 0 of one that does not give way.
        places: of the parameters.

    Returns:
        (masses, parameters) and (n, parameters).
    """
    n, rotors, count = numbers.rotors.size, numbers.rotors, len(places)
    motors, links, speeds, all_speeds = start[rotors], start[:n], first.speeds, speeds_at_start(first, numbers)
    carried = spring_torques(first, numbers, link_torques(first, numbers, links))
    compliance = np.where(numbers.flexible, 1.0 / np.where(numbers.flexible, numbers.springs[:, 0], 1.0), 0.0)
    lines = np.array([law is None or law.linear for _, law in numbers.laws])
    if not np.all(lines):
        compliance = np.where(lines, compliance, _slope(lambda torque: deflections(numbers, torque), carried))
    lost = numbers.masses[:n, MassNumbers.PER_TORQUE] * np.sign(speeds)  # share of the torque, lost to friction
    carried = carried + np.where(numbers.flexible, 0.0, own_torques(first, numbers))
    gain = 1.0 / (1.0 - lost * np.sign(carried))
    here = link_torques(first, numbers, links)
    shifted = [link_torques(first, numbers, links + _SMALL * unit) for unit in np.eye(n)]
    turning = np.column_stack([(there - here) / _SMALL for there in shifted])
    direct, own, stretched = (np.zeros((n, count)) for _ in range(3))
    for c, place in enumerate(places):
        if place.of is NumberOf.DELAY:  # a steady torque acts whenever
            continue
        if place.of is NumberOf.LINK:
            unit = replace(numbers, inertials=np.zeros_like(numbers.inertials))
            unit.inertials[place.row, place.column] = 1.0
            direct[:, c] = link_torques(first, unit, links)
        elif place.of is NumberOf.MASS:
            joint = int(np.flatnonzero(rotors == place.row)[0]) if place.row in rotors else place.row
            v = float(speeds[joint])
            one_way = v * (v < 0.0 if place.column == MassNumbers.BACKWARDS else v >= 0.0)
            constant = float(v != 0.0 or place.row == rotors[joint])
            effects = [first.accelerations[joint], v, np.sign(v), constant, one_way, one_way]
            if place.column == MassNumbers.PER_TORQUE:
                effect = float(np.abs(carried[joint]) * np.sign(v))
            elif place.column >= MassNumbers.RISE:
                effect = _slope_by_number(lambda other: friction_at(other, all_speeds), numbers, place)
            else:
                effect = float(effects[place.column])
            (own if place.row == rotors[joint] else direct)[joint, c] = effect
        elif lines[place.row]:
            stretched[place.row, c] = (motors - links)[place.row] if place.column == 0 else 0.0
        elif compliance[place.row] > 0.0:
            gives = _slope_by_number(lambda other: deflections(other, carried), numbers, place)
            stretched[place.row, c] = -gives / compliance[place.row]
    direct, turning = gain[:, np.newaxis] * direct, gain[:, np.newaxis] * turning
    direct += np.where(numbers.flexible, 0.0, gain - 1.0)[:, np.newaxis] * own
    moved = turning @ (soft[:, np.newaxis] * own + compliance[:, np.newaxis] * stretched) + direct
    load = np.linalg.solve(np.eye(n) - turning * (soft - compliance), moved)
    dq = np.zeros((start.size, count))
    of_motor = soft[:, np.newaxis] * (load + own)
    dq[:n] = of_motor - compliance[:, np.newaxis] * (load - stretched)
    dq[rotors] = of_motor
    return dq, load + own


def _slope(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Return the derivative of a function that acts number by number."""
    step = _RELATIVE * np.maximum(np.abs(at), 1.0)
    return np.asarray((function(at + step) - function(at - step)) / (2.0 * step))


def _slope_by_number(
    function: Callable[[RobotNumbers], FloatArray], numbers: RobotNumbers, place: NumberPlace
) -> float:
    """Return the derivative of a function's entry for a row by one of the row's numbers."""

    def change(value: FloatArray) -> FloatArray:
        return function(with_values(numbers, (place,), value))[[place.row]]

    return float(_slope(change, np.array([place.read(numbers)]))[0])


def columns_of(
    tree: Tree, numbers: RobotNumbers, places: tuple[NumberPlace, ...], motion: MassMotion, rows: IntArray
) -> list[tuple[IntArray, FloatArray]]:
    """Return, for each of some masses, the derivatives of its equation by the parameters that act in it.

    At a known motion, so these are the regressor's columns; their product with the parameters is the motor's torque,
    and 0 for the link of a flexible joint. Each is the places of the parameters, (own,), and their columns,
    (samples, own), which stand one after the other.

    Args:
        tree: of `RobotInput`.
        numbers: of which only the rotors are read, and the speeds below which friction rises.
        places: of the parameters.
        motion: of all masses.
        rows: of the masses.
    """
    from jointid.models.robots.equations import regressor_columns

    samples, n = len(motion.position), numbers.rotors.size
    carried = _find_carriers(tree.parents) if tree.joints.size == 0 else np.ones((n, n), dtype=np.bool_)
    felt = [np.array([c for c, p in enumerate(places) if _acts(p, int(row), numbers, carried)], int) for row in rows]
    ends = np.cumsum([own.size for own in felt])
    lines, of_links = np.empty((int(ends[-1]), samples)), []
    position, velocity, acceleration = motion.position, motion.velocity, motion.acceleration
    for row, own, end in zip(rows, felt, ends, strict=True):
        for line, place in zip(range(int(end) - own.size, int(end)), (places[c] for c in own), strict=True):
            if place.of is NumberOf.LINK:
                of_links.append((row, len(SYMBOLS) * place.row + place.column, line))
            elif place.of is NumberOf.MASS:
                lines[line] = _of_mass(motion, int(row), place.column, numbers)
            else:
                moved, motor = (velocity if place.column else position), numbers.rotors[place.row]
                stretch = moved[:, motor] - moved[:, place.row]
                lines[line] = stretch if row == motor else -stretch
    if of_links:
        q, v, a = (np.ascontiguousarray(values[:, :n]) for values in (position, velocity, acceleration))
        whose, which, where = np.array(of_links, dtype=np.int64).T.copy()
        spans = np.array_split(np.arange(samples), threads())

        def fill(span: NDArray[np.intp]) -> None:
            inside = slice(span[0], span[-1] + 1)
            regressor_columns(tree, q[inside], v[inside], a[inside], whose, which, where, span[0], lines)

        in_threads(fill, [span for span in spans if span.size])
    return [(own, lines[end - own.size : end].T) for own, end in zip(felt, ends, strict=True)]


def _find_carriers(parents: IntArray) -> NDArray[np.bool_]:
    """Return a matrix, (n, n), True where a link carries another or itself."""
    found = np.eye(parents.size, dtype=np.bool_)
    for i, parent in enumerate(parents):
        if parent >= 0:
            found[:, i] |= found[:, parent]
    return found


def _acts(place: NumberPlace, row: int, numbers: RobotNumbers, carried: NDArray[np.bool_]) -> bool:
    """True of a parameter that is in the equation of a mass."""
    if place.of is NumberOf.DELAY:
        return False
    if place.of is NumberOf.LINK:
        return row < len(carried) and bool(carried[row, place.row])
    return row == place.row or (place.of is NumberOf.SPRING and row == numbers.rotors[place.row])


def _of_mass(motion: MassMotion, row: int, column: int, numbers: RobotNumbers) -> FloatArray | float:
    """Return the regressor column of a number of a mass, (samples,)."""
    velocity = motion.velocity[:, row]
    if column in (0, 2):
        return motion.acceleration[:, row] if column == 0 else motion.direction[:, row]
    if column == 3:
        return 1.0
    if column == 6:
        return motion.direction[:, row] * stribeck_share(numbers.masses[row], velocity)
    if column == 1:
        return velocity
    if column not in (4, 5):
        raise NotImplementedError(f"the equations are not linear in number {column} of a mass")
    return np.asarray(np.maximum(velocity, 0.0) if column == 4 else np.minimum(velocity, 0.0))
