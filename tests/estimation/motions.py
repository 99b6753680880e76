"""A motion, a linear model of a rigid joint on it, and noise, cheap enough for hundreds of runs."""

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.simulation.excitation import trapezoids

STEP = 0.01  # s


def motion(duration: float = 40.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and acceleration of trapezoids at three speeds, each (rows,)."""
    position = trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, STEP, duration=duration)
    velocity = np.gradient(position, STEP)
    return position, velocity, np.gradient(velocity, STEP)


def columns(velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the inverse-dynamic columns of a rigid joint, (rows, 4)."""
    return np.column_stack([acceleration, velocity, np.sign(velocity), np.ones_like(velocity)])


def low_passed(random: np.random.Generator, size: int) -> FloatArray:
    """Return noise of variance 1 that is correlated over five rows, (size,)."""
    return np.convolve(random.standard_normal(size + 4), np.ones(5) / np.sqrt(5.0), "valid")


def field(random: np.random.Generator, position: FloatArray, length: float) -> FloatArray:
    """Return one smooth random function of the position, of variance 1 and that correlation length, (rows,)."""
    waves, phases = random.standard_normal(40) / length, random.uniform(0.0, 2 * np.pi, 40)
    return np.asarray(np.cos(np.outer(position, waves) + phases).sum(axis=1) / np.sqrt(20))
