"""Run the oracle's cases through the project's kernel."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from jointid.models.friction import SmoothFriction
from jointid.models.springs import SmoothSpring
from jointid.simulation.kernels import drive as kernels
from jointid.simulation.kernels import engine
from jointid.simulation.plant import assemble, motion_of
from tests.simulation.oracle import Law, Plant

Laws = tuple[SmoothFriction, SmoothFriction, SmoothSpring]


def drive(plant: Plant) -> np.ndarray:
    """Return the kernel's row of coefficients for a plant of the oracle."""
    common = [plant.offset, plant.load_offset if plant.inertia2 is not None else 0.0]
    if plant.inertia2 is None:
        return np.array([plant.inertia1, 1.0, 0.0, 0.0, *plant.fv1, *plant.fc1, 0.0, 0.0, 0.0, 0.0, *common])
    spring = [plant.stiffness, plant.damping]
    return np.array([plant.inertia1, plant.inertia2, *spring, *plant.fv1, *plant.fc1, *plant.fv2, *plant.fc2, *common])


def bands(points: tuple[tuple[float, float], ...]) -> list[tuple[float, float, float, float]]:
    """Return where each line of a friction's rest begins and ends, its slope, and what it is at no speed."""
    points = points or ((0.0, 0.0),)
    found = []
    for (low, more), (high, there) in pairwise([*points, (math.inf, points[-1][1])]):
        slope = (there - more) / (high - low)
        found.append((low, high, slope, more - slope * low))
    return found


FINE = 0.005  # rad in a step
NOTHING = SmoothFriction(), SmoothFriction(), SmoothSpring()


def mass(
    inertia: float, offset: float, fv: tuple[float, float], fc: tuple[float, float],
    points: tuple[tuple[float, float], ...], smooth: SmoothFriction,
) -> np.ndarray:  # fmt: skip
    """Return the engine's rows of a mass, one for each line of its friction's rest."""
    winding = 1.0 / smooth.presliding if smooth.presliding else 0.0
    return np.array([
        [inertia, offset, *(v + slope for v in fv), *(c + more for c in fc), winding, *smooth[1:], high]
        for _, high, slope, more in bands(points)
    ])  # fmt: skip


def engine_plant(plant: Plant, laws: Laws, places: np.ndarray) -> engine.Plant:
    """Return the engine's numbers of a plant of the oracle."""
    motor, load, more = laws
    masses = [mass(plant.inertia1, plant.offset, plant.fv1, plant.fc1, plant.more1, motor)]
    springs = []
    if plant.inertia2 is not None:
        own = (1.0 - more.swing_share) * plant.inertia2
        masses.append(mass(own, plant.load_offset, plant.fv2, plant.fc2, plant.more2, load))
        beside = more.cubic, more.slips, more.slider / more.slips if more.slips else 0.0
        pieces = plant.pieces or ((0.0, 0.0, plant.stiffness, plant.damping),)
        springs.append(np.array([[k, d, *beside, torque - k * begin, begin] for begin, torque, k, d in pieces]))
    if more.swing_share:
        masses.append(mass(more.swing_share * (plant.inertia2 or 0.0), 0.0, (0, 0), (0, 0), (), SmoothFriction()))
        springs.append(np.array([[more.swing_stiffness, more.swing_damping, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    return assemble(masses, springs, places, [(0, 1), (1, 2)][: len(springs)], [0], [-1, 0, 1][: len(masses)])


def run(
    plant: Plant,
    law: Law,
    w: np.ndarray,
    post: np.ndarray,
    T: float,
    delay: float,
    before: float,
    x0: np.ndarray,
    far: float = math.inf,
    laws: Laws | None = None,
    places: np.ndarray | None = None,
    reach: float = engine.REACH,
) -> tuple[int, np.ndarray, np.ndarray, np.ndarray]:
    """Return status, torque (n,), states at the controller's instants (n, 4) and counts; in steps if laws are given."""
    late = delay / T
    whole = math.floor(late + 1e-9)
    fraction = late - whole
    lengths, lags = [T], [whole]
    if fraction > 1e-9:
        lengths, lags = [fraction * T, (1 - fraction) * T], [whole + 1, whole]
    nz = np.size(law.C)
    x = np.zeros(4)
    x[: len(x0)] = x0
    n, parts, counts = len(w), len(lengths), np.zeros(4, dtype=np.int64)
    u, states = np.empty(n), np.zeros((n * parts, 4))
    feedback = kernels.Feedback(
        np.array(law.A, dtype=float).reshape(1, 1, nz, nz),
        np.array(law.Bq, dtype=float).reshape(1, 1, nz),
        np.array(law.Be, dtype=float).reshape(1, 1, nz, 1),
        np.array(law.C, dtype=float).reshape(1, 1, 1, nz),
        np.array([[[law.D]]], dtype=float),
        np.zeros((1, 1, 1, 1)),
        np.array([[law.limit]], dtype=float),
        np.array([[-1]]),
        np.zeros((1, 0, nz)),
        np.zeros(1, dtype=np.int64),
    )
    loop = kernels.SampledLoop(
        np.array(lengths),
        np.array([lags]),
        np.ones(1, dtype=np.int64),
        feedback,
        np.ascontiguousarray(w, dtype=float)[np.newaxis, np.newaxis],
        np.ascontiguousarray(post, dtype=float)[np.newaxis],
    )
    z = np.array(law.z0, dtype=float).reshape(1, nz).copy()
    if laws is None and not (plant.pieces or plant.more1 or plant.more2 or any(plant.gravity)):
        trace = kernels.Trace(
            u, np.empty((0, 1)), states, np.empty(len(states), dtype=np.int16), np.empty((0, kernels.TAPE)), counts
        )
        status = kernels.run(drive(plant), loop, float(before), z, x, far, trace)
        return status, u, states[::parts], counts
    places = np.zeros((0, 5)) if places is None else places
    if any(plant.gravity):
        places = np.vstack([places, [*plant.gravity, float(plant.inertia2 is not None)]])
    numbers = engine_plant(plant, laws or NOTHING, places)
    masses, side = len(numbers.masses), np.minimum(np.arange(len(numbers.masses)), 1)
    for rows in (2 * n * parts + 1000, 0):
        tape = np.empty((rows or counts[1], engine.tape_width(masses, len(numbers.pairs))))
        counts[:] = 0
        status = engine.run(
            numbers, None, np.zeros((0, 10)), loop, np.array([float(before)]), np.array([far]), z.copy(), x[2 * side],
            x[2 * side + 1], np.full(masses, float(np.sign(x[1]))), 0.0, reach, u[np.newaxis], np.empty((1, 0, 1)),
            tape, counts,
        )  # fmt: skip
        if counts[1] <= len(tape):
            break
    position, velocity, *_ = motion_of(tape[: counts[1]], masses, n * parts)
    shown = min(masses, 2)
    states[: len(position), : 2 * shown : 2] = position[:, :shown]
    states[: len(position), 1 : 2 * shown : 2] = velocity[:, :shown]
    return status, u, states[::parts], counts
