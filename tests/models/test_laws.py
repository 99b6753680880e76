"""Every law and its parts against SciPy, and against the equations of docs/controllers.md written out once more."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import dlsim, lfilter

from jointid.models.controllers import (
    DIRECTION,
    INJECTED,
    PD,
    PID,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Cascade,
    FirstOrder,
    Notch,
    SecondOrder,
    run,
)
from jointid.models.controllers.filters import DigitalFilter, MovingAverage
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.controllers.sampled import CONSTANT, INPUTS
from jointid.records.record import Channel, Timing
from jointid.records.resampling import at_period
from tests.models.written_out import SETTLED, torque_of

T = 1e-3
PERIODS = 400


def worst(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, of the peak."""
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


# Linear laws against SciPy


def smooth(rng: np.random.Generator, size: float = 0.1) -> np.ndarray:
    """A motion of some 10 Hz."""
    return np.asarray(size * np.cumsum(lfilter([0.05], [1.0, -0.95], rng.normal(size=PERIODS))) * 0.01)


def test_a_state_space_law_is_scipys() -> None:
    rng = np.random.default_rng(3)
    r, q = smooth(rng), smooth(rng)
    A, B, C = np.array([[0.9, 0.1], [-0.2, 0.7]]), rng.normal(size=(2, 2)), rng.normal(size=2)
    D = rng.normal(size=2)
    made = StateSpaceController(
        A=A, B={"reference": B[:, 0], "position": B[:, 1]}, C=C, D={"reference": D[0], "position": D[1]}, gain=3.0
    )
    inputs = np.zeros((PERIODS, INPUTS))
    inputs[:, REFERENCE], inputs[:, POSITION] = r, q
    _, expected, _ = dlsim((A, B, 3.0 * C[np.newaxis], 3.0 * D[np.newaxis], T), np.stack([r, q], axis=1))
    assert worst(run(made.law(T), inputs, np.zeros(2)), expected[:, 0]) <= 1e-12


# Every law, written out


def driven(rng: np.random.Generator, T: float) -> np.ndarray:
    """Inputs of a law, at first in uniform motion."""
    inputs = np.zeros((PERIODS, INPUTS))
    inputs[:, REFERENCE], inputs[:, POSITION] = smooth(rng), smooth(rng)
    inputs[:, POSITION] += inputs[0, REFERENCE] - inputs[0, POSITION]
    inputs[1, REFERENCE] = inputs[0, REFERENCE] + 0.02 * T
    inputs[:, REFERENCE_VELOCITY] = rng.normal(size=PERIODS)
    inputs[1:, DIRECTION] = np.sign(np.diff(inputs[:, REFERENCE]))
    inputs[0, DIRECTION] = inputs[1, DIRECTION]
    inputs[:, CONSTANT] = 1.0
    inputs[1:, INJECTED] = 3.0 * (rng.uniform(size=PERIODS - 1) > 0.8)
    return inputs


def expected(law: Cascade | PD, T: float, inputs: np.ndarray, speed: float) -> np.ndarray:
    """The torque, (periods,), behind uniform motion up to the first period."""
    before = np.arange(-SETTLED, 0) * T
    whole = np.vstack([np.repeat(inputs[:1], SETTLED, axis=0), inputs])
    whole[:SETTLED, REFERENCE] += (inputs[1, REFERENCE] - inputs[0, REFERENCE]) / T * before
    whole[:SETTLED, POSITION] += speed * before
    whole[:SETTLED, INJECTED] = 0.0
    columns = (REFERENCE, REFERENCE_VELOCITY, DIRECTION, INJECTED, POSITION)
    return torque_of(law, T, *(whole[:, column] for column in columns))


def check(law: Cascade | PD, seed: int, T: float = T, speed: float = 0.03) -> tuple[float, float]:
    """Assert that the law is what is written; return how often the torque's limit and the others act."""
    inputs = driven(np.random.default_rng(seed), T)
    lowered = law.law(T)
    slope = (inputs[1, REFERENCE] - inputs[0, REFERENCE]) / T
    state = lowered.memory(REFERENCE, inputs[0, REFERENCE], slope) + lowered.memory(
        POSITION, inputs[0, POSITION], speed
    )
    for column in (REFERENCE_VELOCITY, DIRECTION, CONSTANT):
        state += lowered.memory(column, inputs[0, column], 0.0)
    excess, wanted = np.zeros((len(inputs), lowered.limits.size)), expected(law, T, inputs, speed)
    found = run(lowered, inputs, state, excess)
    peak = np.max(np.abs(wanted))
    assert np.max(np.abs(found - wanted)) <= 1e-9 * peak
    acts = np.mean(excess != 0.0, axis=0)
    return float(acts[lowered.output]), float(np.sum(acts) - acts[lowered.output])


PLAIN: dict[str, Cascade | PD] = {
    "P-PI": Cascade(position_gain=60.0, velocity_gain=900.0, integral_gain=40.0),
    "PID": PID(position_gain=4e3, integral_gain=9e4, derivative_gain=60.0),
}


@pytest.mark.parametrize("windup", ["hold", "track", "none"])
@pytest.mark.parametrize("name", ["P-PI", "PID"])
def test_each_anti_windup_is_its_equation(name: str, windup: str) -> None:
    filters = (SecondOrder(150.0), Notch(80.0, 40.0, 0.2))
    limit = {"P-PI": 1000.0, "PID": 12.0}[name]
    law = replace(PLAIN[name], limit=limit, gain=0.5, anti_windup=windup, torque_filters=filters)
    limited, others = check(law, seed=7)
    assert 0.1 < limited < 0.95
    assert (others > 0.05) == (windup == "hold")


def random_filter(rng: np.random.Generator) -> Any:
    return (
        DigitalFilter(tuple(rng.uniform(-1, 1, 3)), (1.0, *rng.uniform(-0.4, 0.4, 2))),
        MovingAverage(int(rng.integers(1, 9))),
        FirstOrder(rng.uniform(0, 5e-3)),
        SecondOrder(rng.uniform(30, 400), rng.uniform(0.3, 1.5)),
        SecondOrder(rng.uniform(30, 400), rng.uniform(0.3, 1.5), rng.uniform(30, 400), rng.uniform(0, 1)),
        Notch(rng.uniform(30, 400), rng.uniform(20, 80), rng.uniform(0, 1)),
    )[rng.integers(6)]


def random_law(rng: np.random.Generator) -> Cascade | PD:
    def some(value: Any, otherwise: Any = 0.0) -> Any:
        return value if rng.uniform() < 0.5 else otherwise

    n = int(rng.integers(1, 9))
    common = {
        "gain": some(rng.uniform(0.1, 10.0), 1.0),
        "reference_delay": some(rng.uniform(0, 6e-3)),
        "velocity_filter": some(random_filter(rng), (0.5, 0.5)),
        "torque_filters": tuple(random_filter(rng) for _ in range(rng.integers(0, 4))),
        "acceleration_feedforward": some(rng.uniform(0, 0.3)),
        "viscous_feedforward": some(rng.uniform(0, 20.0)),
        "coulomb_feedforward": some(rng.uniform(0, 5.0)),
        "constant_feedforward": some(rng.uniform(-5, 5)),
        "limit": some(rng.uniform(3, 40), math.inf),
        "reference_velocity": rng.choice(["difference", "channel"]),
    }
    # What is tracked must not lag, or it swings ever wider, and rounding with it.
    windup = rng.choice(["hold", "none"] if common["torque_filters"] else ["hold", "track", "none"])
    kind = rng.integers(3)
    if kind == 0:
        return Cascade(
            position_gain=rng.uniform(5, 90), velocity_gain=rng.uniform(100, 900), integral_gain=some(rng.uniform(1,
            90)), anti_windup=windup,
            velocity_feedforward=some(rng.uniform(0, 1)),
            velocity_limit=some(rng.uniform(0.01, 0.1), math.inf), position_period=n * T,
            position_offset=int(rng.integers(0, 12)) * T, **common,
        )  # fmt: skip
    gains = {"position_gain": rng.uniform(100, 4e3), "derivative_gain": rng.uniform(0, 60)}
    if kind == 1:
        return PD(**gains, **common)
    return PID(integral_gain=rng.uniform(0, 9e4), anti_windup=windup, **gains, **common)


@pytest.mark.parametrize("seed", [*range(12), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(12, 60))])
def test_any_law_is_its_equation(seed: int) -> None:
    check(random_law(np.random.default_rng([seed, 8])), seed)


def test_a_filter_with_a_diagonal_of_one_is_no_integrator() -> None:
    """In observer form its matrix has a 1 on the diagonal, but its poles are inside the circle."""
    check(
        PD(position_gain=4e3, derivative_gain=60.0, torque_filters=(DigitalFilter((0.5,), (1.0, -1.0, 0.5)),)), seed=9
    )
    filtered = PD(position_gain=1.0, derivative_gain=1.0, velocity_filter=DigitalFilter((0.5,), (1.0, -1.0, 0.5)))
    assert not filtered.law(T).integrates
    assert PID(position_gain=1.0, integral_gain=1.0, derivative_gain=1.0).law(T).integrates


# The reference between two commands


@pytest.mark.parametrize("repeat", [1, 2, 8, 32])
def test_a_slow_reference_is_filled_in(repeat: int) -> None:
    values = np.cumsum(np.random.default_rng(4).normal(size=60))
    channel = Channel(values, "m", repeat * T, Timing.SAMPLED)
    k = np.arange(60)
    at = np.minimum(np.arange(60 * repeat) / repeat, 59)  # the last command stays
    slopes = np.gradient(values)  # half the difference of the neighbours; at the ends that with the only one
    cubic = CubicHermiteSpline(k, values, slopes)(at)
    expected = {"hold": values[at.astype(int)], "linear": np.interp(at, k, values), "cubic": cubic}
    for interpolation, filled in expected.items():
        found = at_period(channel, T, 60 * repeat, "reference", interpolation)  # type: ignore[arg-type]
        assert np.max(np.abs(found - filled)) <= 1e-12 * np.max(np.abs(values)), interpolation
    assert np.array_equal(at_period(channel, T, 60 * repeat, "r"), at_period(channel, T, 60 * repeat, "r", "linear"))
    held = replace(channel, timing=Timing.HELD)
    assert np.array_equal(at_period(held, T, 60 * repeat, "r"), at_period(channel, T, 60 * repeat, "r", "hold"))
