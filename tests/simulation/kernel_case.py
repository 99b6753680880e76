"""Run the oracle's cases through the project's kernel."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from jointid.models.smooth import SmoothLaws
from jointid.simulation.kernels import drive as kernels
from jointid.simulation.kernels import engine
from jointid.simulation.plant import plant_of_numbers
from tests.simulation.oracle import Law, Plant


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


def segments(plant: Plant) -> np.ndarray:
    """Return the kernel's rows for a spring and a friction in pieces: each side's, from the line through each piece."""
    if not (plant.pieces or plant.more1 or plant.more2):
        return kernels.NO_SEGMENTS
    pieces = plant.pieces or ((0.0, 0.0, plant.stiffness, plant.damping),)
    motor, load = bands(plant.more1), bands(plant.more2)
    steps = [len(motor) * len(load), len(load), 1]
    springs, ends = [], [*(piece[0] for piece in pieces[1:]), math.inf]
    for i, ((begin, torque, stiffness, damping), end) in enumerate(zip(pieces, ends, strict=True)):
        for side in (1.0,) if i == 0 else (-1.0, 1.0):
            row = drive(plant)
            row[2:4] = stiffness, damping
            row[12:] += np.array([-1.0, 1.0]) * side * (torque - stiffness * begin)
            low, high = (begin, end) if side > 0 else (-end, -begin)
            springs.append([*row, -end if i == 0 else low, high])
    rows = []
    for spring in sorted(springs, key=lambda row: row[14]):
        for one in motor:
            for two in load:
                row = np.array([*spring, *one[:2], *two[:2], *steps])
                row[4:6] += one[2]
                row[6:8] += one[3]
                row[8:10] += two[2]
                row[10:12] += two[3]
                rows.append(row)
    return np.array(rows)


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
    laws: SmoothLaws | None = None,
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
    u, states, counts = np.empty(len(w)), np.empty((len(w) * len(lengths), 4)), np.zeros(4, dtype=np.int64)
    feedback = kernels.Feedback(
        np.array(law.A, dtype=float).reshape(1, nz, nz),
        np.array(law.Bq, dtype=float).reshape(1, nz),
        np.array(law.Be, dtype=float).reshape(1, nz, 1),
        np.array(law.C, dtype=float).reshape(1, 1, nz),
        np.array([[law.D]], dtype=float),
        np.zeros((1, 1, 1)),
        np.array([law.limit], dtype=float),
        np.array([-1]),
        np.zeros((0, nz)),
        0,
    )
    loop = kernels.SampledLoop(
        np.array(lengths),
        np.array(lags),
        feedback,
        np.ascontiguousarray(w, dtype=float)[np.newaxis],
        np.ascontiguousarray(post, dtype=float),
    )
    z = np.array(law.z0, dtype=float).reshape(nz).copy()
    modes, pushed = np.empty(len(states), dtype=np.int16), np.empty((len(states), 2))
    tape = np.empty((0, kernels.TAPE if laws is None else engine.STEP_TAPE))
    trace = kernels.Trace(u, np.empty((0, 1)), states, modes, pushed, tape, counts)
    if laws is not None:
        places = np.zeros((0, 5)) if places is None else places
        numbers = plant_of_numbers(drive(plant), laws, places, flexible=plant.inertia2 is not None)
        status = engine.run(*numbers, loop, float(before), z, x, float(np.sign(x[1])), far, reach, trace)
    else:
        load = float(plant.inertia2 is not None)
        gravity = np.array([*plant.gravity, load]) if any(plant.gravity) else kernels.NO_GRAVITY
        status = kernels.run(drive(plant), loop, float(before), z, x, far, trace, gravity, segments(plant))
    return status, u, states[:: len(lengths)], counts
