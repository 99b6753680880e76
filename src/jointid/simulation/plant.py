"""The numbers of a joint, and of a robot's masses and springs, as `kernels.engine` reads them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, Room
from jointid.models.friction import Friction
from jointid.models.joints import Joint, RigidJoint
from jointid.models.robots.robot import Tree
from jointid.models.springs import LinearSpring, Spring
from jointid.simulation.kernels import engine
from jointid.simulation.kernels.drive import IntArray, SampledLoop, passing
from jointid.simulation.kernels.engine import (
    BEGIN,
    COULOMB,
    COULOMB_BACK,
    COULOMB_DRIFT,
    HIGH,
    INERTIA,
    PART,
    PER_TORQUE,
    SLIPS,
    STATE,
    WINDING,
    Plant,
)
from jointid.simulation.kernels.variation import MASSES, SPRINGS, Seeds

AnyArray: TypeAlias = NDArray[Any]
Blocks: TypeAlias = list[tuple[int, int, FloatArray]]

IMAGINARY = 1e-30
"""A complex step: its square is nothing beside any value."""
NO_LINKS = np.zeros((1, 0, 10))
"""The inertials of a joint, which stands in no tree; and what no motor feels of any."""
HEAVY = 1e18
"""Inertia of a motor that is moved: what acts on one of 1e3 N m moves it by 1e-12 rad in a minute."""
_MORE = 2  # rows of a tape per step and part, beside a thousand


def lower_mass(inertia: Any, offset: Any, law: Friction, values: Mapping[str, Any], prefix: str = "") -> AnyArray:
    """Return a mass in each band of its friction, (bands, MASS + 1); complex of complex values."""
    own = law.beside(values, prefix)
    length, *beside = (own[n] for n in ("presliding_distance", "viscous_drift", "coulomb_drift", "friction_per_torque"))
    winds = 1.0 / length if length != 0.0 else 0.0
    return np.array([[inertia, offset, *b.directions, winds, *beside, b.high] for b in law.bands(values, prefix)])


def lower_spring(law: Spring, values: Mapping[str, Any]) -> AnyArray:
    """Return a spring in each of its pieces, (pieces, SPRING); complex of complex values."""
    own = law.beside(values)
    cubic, slider, slips = (own[name] for name in ("cubic_stiffness", "hysteresis_stiffness", "hysteresis_torque"))
    slides = slider / slips if slips != 0.0 else (math.nan if slider != 0.0 else 0.0)
    return np.array(
        [
            [p.stiffness, p.damping, cubic, slips, slides, p.torque - p.stiffness * p.deflection, p.deflection]
            for p in law.pieces(values)
        ]
    )


def assemble(
    masses: Sequence[AnyArray], springs: Sequence[AnyArray], places: FloatArray, pairs: Sequence[tuple[int, int]],
    motors: Sequence[int], carriers: Sequence[int],
) -> Plant:  # fmt: skip
    """Return the plant of lowered masses and springs, filled up to equal numbers of bands and pieces."""
    pieces = max(map(len, springs), default=1)
    lowered = []
    for spring in springs:
        beyond = np.repeat(spring[-1:], pieces - len(spring), axis=0)
        beyond[:, BEGIN] = math.inf
        lowered.append(np.vstack([spring, beyond]))
    bands = max(map(len, masses))
    whole = np.array([np.vstack([mass, np.repeat(mass[-1:], bands - len(mass), axis=0)]) for mass in masses])
    tied = np.array(pairs, dtype=np.uint64).reshape(-1, 2)
    of_springs = np.array(lowered) if lowered else np.zeros((0, pieces, BEGIN + 1))
    return Plant(whole, of_springs, places, tied, np.array(motors, dtype=np.uint64), np.array(carriers))


def is_possible(plant: Plant, duration: float, links: int = 0) -> bool:
    """Test for masses, springs and friction of a physical joint, for that many seconds.

    Masses are positive, stiffness, damping and friction at rest are not negative, and bands and pieces rise. Of links,
    the first masses, the rotor's inertia may be negative: motion tells its sum with the link alone.
    """
    masses, springs = plant.masses, plant.springs
    numbers = masses[..., :HIGH], springs[..., :BEGIN], plant.places
    rising = np.all(masses[:, 1:, HIGH] >= masses[:, :-1, HIGH]) and np.all(
        springs[:, 1:, BEGIN] >= springs[:, :-1, BEGIN]
    )
    if not (rising and all(np.all(np.isfinite(one)) for one in numbers)):
        return False
    rest, per_torque = masses[:, 0], masses[:, 0, PER_TORQUE]
    drift = rest[:, COULOMB_DRIFT]
    faded = np.min(rest[:, [COULOMB, COULOMB_BACK]], axis=1) + np.minimum(drift, 0.0) * duration
    cones = np.all(rest[:, COULOMB] + rest[:, COULOMB_BACK] >= 0) and np.all((drift >= 0) | (faded >= 0))
    unsigned = springs[..., [0, 1, SLIPS, SLIPS + 1]]
    return bool(
        cones and np.all(rest[links:, INERTIA] > 0) and np.all((per_torque >= 0) & (per_torque < 1))
        and np.all(rest[:, WINDING] >= 0) and np.all(unsigned >= 0)
    )  # fmt: skip


def plant_of(joint: Joint, values: Mapping[str, Any]) -> Plant:
    """Return the numbers of a joint; complex ones of complex values."""
    drive, places, friction = joint.coefficients(values), joint.places(values), joint.friction
    if isinstance(joint, RigidJoint):
        return assemble([lower_mass(drive[0], drive[12], friction, values)], [], places, [], [0], [-1])
    beside = joint.spring.beside(values)
    share, stiffness, damping = (beside[f"swinging_{word}"] for word in ("share", "stiffness", "damping"))
    load, swings = drive[1], np.real(share) > 0.0
    if np.real(share) < 0.0:
        load = math.nan
    elif swings or stiffness + damping == 0.0:
        load = (1.0 - share) * load  # a share that is just beginning moves with the load on its spring
    masses = [
        lower_mass(drive[0], drive[12], friction, values, "motor_"),
        lower_mass(load, drive[13], friction, values, "load_"),
    ]
    springs = [lower_spring(joint.spring, values)]
    if swings:
        masses.append(np.array([[share * drive[1], *np.zeros(HIGH - 1), math.inf]]))
        springs.append(lower_spring(LinearSpring(), {"stiffness": stiffness, "damping": damping}))
    return assemble(masses, springs, places, [(0, 1), (1, 2)][: len(springs)], [0], [-1, 0, 1][: len(masses)])


def heavy_plant(joint: Joint, values: Mapping[str, Any]) -> Plant:
    """Return the joint with a motor so heavy that it follows the prescribed motion."""
    plant = plant_of(joint, values)
    plant.masses[0, :, :HIGH] = 0.0
    plant.masses[0, :, INERTIA] = HEAVY
    return plant


def plant_seeds(
    make: Callable[[Mapping[str, Any]], Plant], values: Mapping[str, float], names: Sequence[str]
) -> Blocks:
    """Return the derivatives of the numbers of a joint that `make` returns by parameters, by a complex step.

    None is a parameter that is not the joint's.
    """
    found: Blocks = []
    for column, name in enumerate(names):
        if name not in values:
            continue
        moved = make({**values, name: complex(values[name], IMAGINARY)})
        places = moved.places[:, np.newaxis, : engine.WAVE]
        for first, rows in ((0, moved.masses[..., :HIGH]), (MASSES, moved.springs), (MASSES + SPRINGS, places)):
            found += [(column, first + row, slope(own)) for row, own in enumerate(rows)]
    return found


def pack_seeds(
    plant: Plant, tree: Tree | None, blocks: Blocks, *, links: Sequence[tuple[int, ...]] = (),
    delays: Sequence[tuple[int, ...]] = (), pushes: Sequence[tuple[int, ...]] = (), pushed: FloatArray | None = None,
) -> Seeds:  # fmt: skip
    """Return the derivatives of a plant's numbers as `kernels.variation` takes them.

    Args:
        plant: whose numbers they are.
        tree: of its links, or None.
        blocks: column of a parameter, row of `Seeds.begin`, and the derivatives, (bands, numbers).
        links: see `Seeds`, as what follows.
        delays: the same.
        pushes: the same.
        pushed: the same.
    """
    found = sorted(
        (row, int(band), int(number), column, float(block[band, number]))
        for column, row, block in blocks
        for band, number in np.argwhere(block)
    )
    rows = len(plant.places) + (MASSES + SPRINGS if tree is None else len(plant.masses) + len(plant.pairs))
    bands = max(plant.masses.shape[1], plant.springs.shape[1])
    keys = [row * bands + band for row, band, *_ in found]
    begin = np.searchsorted(keys, bands * np.arange(rows)[:, np.newaxis] + np.arange(bands + 1))
    numbers, columns = (np.array([one[i] for one in found], dtype=np.int64) for i in (2, 3))
    of_links, of_delays, of_pushes = (
        np.array(one, dtype=np.int64).reshape(-1, width) for one, width in ((links, 3), (delays, 2), (pushes, 2))
    )
    values, none = np.array([one[4] for one in found]), np.zeros((0, 0))
    return Seeds(begin, numbers, columns, values, of_links, of_delays, of_pushes, none if pushed is None else pushed)


def slope(moved: AnyArray) -> FloatArray:
    """Return the derivatives of numbers after a complex step."""
    return np.asarray(np.imag(moved) / IMAGINARY)


class Integrated(NamedTuple):
    """A run of `kernels.engine`.

    Attributes:
        status: how it ended.
        command: (axes, clock) torques that act, the last held after a failure.
        excess: (axes, periods, elements) what limits and gates took away, where it was kept.
        tape: (rows, columns) its steps, where they were kept.
        counts: (4,) events, rows of the tape, steps of the clock, and those at a limit.
    """

    status: int
    command: FloatArray
    excess: FloatArray
    tape: FloatArray
    counts: IntArray


def integrate(
    plant: Plant, tree: Tree | None, inertials: FloatArray, loop: SampledLoop, before: FloatArray, far: FloatArray,
    z: FloatArray, place: FloatArray, speed: FloatArray, wound: FloatArray, *, keep: bool, steps: int = 0,
    room: Room | None = None,
) -> Integrated:  # fmt: skip
    """Run `kernels.engine`, and keep its tape on demand, in the memory of a room.

    The arguments are those of `kernels.engine.run`. Steps are those of the integrator in the longest part of a step of
    the clock; 0 lets each choose its length.
    """
    axes, clock = loop.post.shape
    parts, (_, elements, periods) = loop.lengths.size, loop.w.shape
    array, command = (room or Room()).array, np.zeros((axes, clock))  # never in a room: it may be an answer
    excess = array("excess", (axes, periods if keep else 0, elements))
    rows = _MORE * clock * parts * max(steps, 1) + 1000 if keep else 0
    rate, reach = (steps / float(np.max(loop.lengths)), 1.0) if steps else (0.0, engine.REACH)
    while True:
        tape, counts = (
            array("tape", (rows, engine.tape_width(len(plant.masses), len(plant.pairs)))),
            np.zeros(4, np.int64),
        )
        status = engine.run(
            plant, tree, inertials, loop, before, far, z.copy(), place, speed, wound, rate, reach, command, excess,
            tape, counts,
        )  # fmt: skip
        if not keep or counts[1] <= rows:  # else joints that turn round and stick all the time
            break
        rows = int(counts[1])
    done = int(counts[2])
    command[:, done:] = command[:, done - 1 : done] if done else 0.0
    for j, every in enumerate(loop.every):
        excess[j, -(-done // int(every)) :] = 0.0
    np.nan_to_num(command, copy=False, nan=0.0, posinf=0.0, neginf=0.0)  # divergence may overflow
    return Integrated(status, command, excess, tape[: counts[1]], counts)


def move_motors(
    plant: Plant, tree: Tree | None, inertials: FloatArray, joined: FloatArray, step: float, start: FloatArray,
    speeds: FloatArray, steps: int = 0,
) -> Integrated:  # fmt: skip
    """Simulate masses behind motors whose inertia is `HEAVY`, along velocities, (edges, n), from a first state.

    One more part follows the last one, so that its end is on the tape, too. Other arguments are those of `integrate`.
    """
    held = np.diff(joined, axis=0) / step
    torques = HEAVY * np.vstack([held, held[-1:]]).T[:, np.newaxis]
    n = len(torques)
    return integrate(
        plant, tree, inertials, pass_on(torques, step), np.zeros(n), np.full(n, math.inf), np.zeros((n, 0)), start,
        speeds, np.sign(speeds), keep=True, steps=steps,
    )  # fmt: skip


def pass_on(torques: FloatArray, step: float) -> SampledLoop:
    """Return torques, (joints, 1, parts), that each act in one part of `step` seconds, as the kernels take them."""
    joints, _, parts = torques.shape
    lags, every = np.zeros((joints, 1), dtype=np.int64), np.ones(joints, dtype=np.int64)
    given = np.ascontiguousarray(torques)
    return SampledLoop(np.array([step]), lags, every, passing(joints), given, np.zeros((joints, parts)))


def motion_of(tape: FloatArray, masses: int, parts: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the motion as each part begins: positions, velocities, accelerations and modes, (parts, masses) each."""
    first = tape[np.flatnonzero(np.diff(tape[:, PART], prepend=-1.0))[:parts]]
    position, velocity, acceleration, _, modes = (
        first[:, STATE + i * masses : STATE + (i + 1) * masses] for i in range(5)
    )
    return position, velocity, acceleration, modes
