"""Derivatives of a robot's torques by its parameters: by variation of a run, or as columns at a known motion.

The variation is that of `kernels.variation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

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
from jointid.simulation.kernels.engine import HIGH
from jointid.simulation.loop_input import LoopInput, acting, averages, seen_torque, to_log
from jointid.simulation.plant import IMAGINARY, pack_seeds, slope
from jointid.simulation.robot_numbers import (
    NumberOf,
    NumberPlace,
    RobotNumbers,
    mass_of,
    spring_of,
    stribeck_share,
    with_values,
)
from jointid.simulation.robots import (
    FirstSample,
    MassMotion,
    RobotRun,
    controllers_at,
    deflections,
    link_torques,
    motion_at,
    own_torques,
    spring_torques,
)

if TYPE_CHECKING:
    from jointid.simulation.kernels.variation import Seeds

Start: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]

_RELATIVE = 1e-5  # of a number: differences of what balances at the first sample
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
    still, states = np.zeros((len(run.numbers.masses), count)), run.experiment.sampled.feedback.A.shape[-1]
    pushing = [(i, j) for i, (j, _) in enumerate(changes)]
    start = still, still, np.zeros((n, states, count))
    return _follow(run, (), start, pushing, pushes), direct


def _run_law(experiment: LoopInput, position: FloatArray, speed: float) -> LawRun:
    """Return a law's run along a motor position, (periods,), that begins at a speed."""
    law, inputs = experiment.law, experiment.inputs.copy()
    inputs[:, POSITION] = position
    return run_law(law, inputs, law.known_memory(inputs) + law.memory(POSITION, float(position[0]), speed))


def _follow(
    run: RobotRun, places: tuple[NumberPlace, ...], start: Start, pushes: Sequence[tuple[int, int]] = (),
    pushed: FloatArray | None = None,
) -> list[FloatArray]:  # fmt: skip
    """Return the derivatives of the torques as the log shows them, by joint, (samples, parameters) each.

    Pushes, (pushes, clock), are torques added to controllers' outputs; in the result they are left out.
    """
    from jointid.simulation.kernels.drive_sensitivities import Moved, Slopes
    from jointid.simulation.kernels.variation import follow
    from jointid.simulation.plant import NO_LINKS

    experiment, clock, numbers = run.experiment, run.experiment.clock, run.experiment.carrying(run.numbers)
    (n, _, elements), count = run.excess.shape, start[0].shape[1]
    command = np.zeros((n, clock.steps, count))
    moved = Moved(*start, np.zeros((n, 0, elements, 0)), count, np.zeros((n, elements, count)))
    plant, seeds = numbers.plant, seeds_of(experiment.tree, numbers, places, pushes, pushed)
    follow(
        plant, experiment.tree, numbers.inertials, experiment.sampled, run.before, run.command, run.excess, run.tape,
        seeds, moved, Slopes(command, np.zeros((0, 4, count)), NO_LINKS),
    )  # fmt: skip
    for column, j in pushes:
        command[j, :, column] -= seeds.pushed[column]
    found = []
    for j, each in enumerate(experiment.experiments):
        logged = to_log(each, clock.own(j, command[j], each.periods))
        late = [c for c, place in enumerate(places) if place.of is NumberOf.DELAY and place.row == j]
        if late and each.tap is Tap.MEASURED and each.timing is Timing.AVERAGED:
            # An edge that moves takes its height from the mean over the sample time it stands in.
            torque = acting(each, seen_torque(each, clock.own(j, run.command[j], each.periods)))
            edges = -np.diff(torque, prepend=torque[0])
            logged[:, late] += averages(each, edges)[:, np.newaxis]
        found.append(logged[: clock.samples])
    return found


def seeds_of(
    tree: Tree, numbers: RobotNumbers, places: Sequence[NumberPlace], pushes: Sequence[tuple[int, int]] = (),
    pushed: FloatArray | None = None,
) -> Seeds:  # fmt: skip
    """Return how the numbers that the kernels read depend on parameters, by a complex step: rational functions."""
    spring, blocks = len(numbers.masses) - 1 + np.cumsum(numbers.flexible), []
    for c, place in enumerate(places):
        if place.of not in (NumberOf.MASS, NumberOf.SPRING):
            continue
        row = numbers.arrays[place.of][place.row].astype(np.complex128)
        row[place.column] += 1j * IMAGINARY
        if place.of is NumberOf.MASS:
            blocks.append((c, place.row, slope(mass_of(row, numbers.frictions[place.row]))[:, :HIGH]))
        else:
            blocks.append((c, int(spring[place.row]), slope(spring_of(row, numbers.laws[place.row][1]))))
    links = [(c, place.row, place.column) for c, place in enumerate(places) if place.of is NumberOf.LINK]
    delays = [(c, place.row) for c, place in enumerate(places) if place.of is NumberOf.DELAY]
    return pack_seeds(
        numbers.plant, tree, blocks, links=links, delays=delays, pushes=pushes, pushed=pushed
    )  # fmt: skip


def _at_start(run: RobotRun, places: tuple[NumberPlace, ...]) -> Start:
    """Return the derivatives at the first sample: of positions, velocities and controllers' states.

    Of `robots.begin`: ``load(q) + own = torque(qm)`` where the law has no integral, ``qm`` the reference where it
    has; ``K (qm - q) = load(q)``.
    """
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
    return dq, np.zeros_like(dq), dz


def slopes_at_start(
    first: FirstSample, numbers: RobotNumbers, start: FloatArray, soft: FloatArray, places: Sequence[NumberPlace]
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
    n, links = numbers.rotors.size, start[: numbers.rotors.size]

    def carry(other: RobotNumbers, places: FloatArray) -> FloatArray:
        return spring_torques(first, other, link_torques(first, other, places))

    def balance(other: RobotNumbers) -> FloatArray:
        return np.stack([carry(other, links), own_torques(first, other), deflections(other, load)])

    load = carry(numbers, links)
    turning = np.column_stack([(carry(numbers, links + _SMALL * unit) - load) / _SMALL for unit in np.eye(n)])
    step = _RELATIVE * np.maximum(np.abs(load), 1.0)
    compliance = (deflections(numbers, load + step) - deflections(numbers, load - step)) / (2.0 * step)
    moved = np.zeros((3, n, len(places)))
    for c, place in enumerate(places):
        if place.of in (NumberOf.LINK, NumberOf.MASS, NumberOf.SPRING):
            value = place.read(numbers)
            by = _RELATIVE * max(abs(value), 0.1)
            low, high = (balance(with_values(numbers, (place,), np.array([value + d]))) for d in (-by, by))
            moved[:, :, c] = (high - low) / (2.0 * by)
    direct, own, stretched = moved
    given = turning @ (soft[:, np.newaxis] * own - stretched) + direct
    torque = np.linalg.solve(np.eye(n) - turning * (soft - compliance), given)
    dq = np.zeros((start.size, len(places)))
    of_motor = soft[:, np.newaxis] * (torque + own)
    dq[:n] = of_motor - compliance[:, np.newaxis] * torque - stretched
    dq[numbers.rotors] = of_motor
    return dq, torque + own


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
