"""Every law and its parts against SciPy, and against the equations of docs/controllers.md written out once more."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import cont2discrete, dlsim, freqz, iirnotch, lfilter

from jointid.models.controllers import (
    CONSTANT,
    DIRECTION,
    INJECTED,
    INPUTS,
    PD,
    PID,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Cascade,
    DigitalFilter,
    FirstOrder,
    MovingAverage,
    Notch,
    SecondOrder,
    StateSpaceController,
    run,
)
from jointid.records.record import Channel, Timing
from jointid.records.resampling import at_period
from tests.models.written_out import Sample, begun

T = 1e-3
PERIODS = 400


def worst(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, of the peak."""
    return float(np.max(np.abs(found - expected)) / np.max(np.abs(expected)))


# Filters


FILTERS = [
    DigitalFilter((0.2, 0.3), (2.0, -1.0, 0.25)),
    DigitalFilter((0.2, 0.3, 0.1, 0.4), (1.0, -0.5)),
    MovingAverage(5),
    FirstOrder(3e-3),
    FirstOrder(0.0),
    SecondOrder(60.0),
    SecondOrder(60.0, 0.3, 90.0, 0.1),
    Notch(80.0, 20.0),
    Notch(80.0, 20.0, 0.1),
]


@pytest.mark.parametrize("made", FILTERS, ids=repr)
def test_a_filter_of_the_torque_is_scipys(made: Any) -> None:
    """Behind a law that is only its reference, so that what is filtered is known."""
    signal = np.random.default_rng(0).normal(size=PERIODS)
    law = PD(position_gain=1.0, derivative_gain=0.0, reference_velocity="none", torque_filters=(made,)).law(T)
    inputs = np.zeros((PERIODS, INPUTS))
    inputs[:, REFERENCE] = signal
    b, a = made.coefficients(T)
    assert worst(run(law, inputs, np.zeros(law.order)).output, lfilter(b, a, signal)) <= 1e-12


@pytest.mark.parametrize("frequency", [5.0, 80.0, 400.0])
def test_a_notch_is_scipys(frequency: float) -> None:
    """`iirnotch` gives its width at the sampled filter; ours is that of the continuous one, at the same centre."""
    w = 2 * math.pi * frequency
    width = 2 * math.atan(0.25 * math.sin(w * T)) / (2 * math.pi * T)  # of a quality of 2 before sampling
    b, a = iirnotch(frequency, frequency / width, fs=1 / T)
    assert np.allclose(Notch(frequency, frequency / 2).coefficients(T), (b, a), rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize("depth", [0.0, 0.1, 1.0, 3.0])
def test_a_notch_leaves_its_depth_at_the_centre_and_all_far_away(depth: float) -> None:
    b, a = Notch(80.0, 20.0, depth).coefficients(T)
    _, response = freqz(b, a, worN=[1e-6, 80.0, 499.999999], fs=1 / T)
    assert np.allclose(np.abs(response), [1.0, depth, 1.0], atol=1e-9)


def test_a_filter_of_second_order_has_its_own_response_at_its_frequencies() -> None:
    low = SecondOrder(60.0, 0.3)
    _, response = freqz(*low.coefficients(T), worN=[0.0, 60.0], fs=1 / T)
    assert np.allclose(response, [1.0, 1 / (2j * 0.3)], atol=1e-12)
    _, at_zeros = freqz(*SecondOrder(60.0, 0.3, 90.0).coefficients(T), worN=[90.0], fs=1 / T)
    assert abs(at_zeros[0]) <= 1e-12


def test_a_filter_of_first_order_has_the_pole_of_the_sampled_one() -> None:
    b, a = FirstOrder(3e-3).coefficients(T)
    num, den, _ = cont2discrete(([1.0], [3e-3, 1.0]), T, "zoh")
    assert np.allclose(a, den, rtol=1e-12)
    assert np.isclose(b[0], num[0][1], rtol=1e-12)  # the same gain, a period earlier
    assert FirstOrder(0.0).coefficients(T) == ((1.0,), (1.0, -0.0))


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
    assert worst(run(made.law(T), inputs, np.zeros(2)).output, expected[:, 0]) <= 1e-12


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
    """The torque, (periods,)."""
    samples = [Sample(row[REFERENCE], row[REFERENCE_VELOCITY], row[DIRECTION], row[INJECTED]) for row in inputs]
    slope = (inputs[1, REFERENCE] - inputs[0, REFERENCE]) / T
    written, _ = begun(law, T, samples[0], slope, inputs[0, POSITION], speed)
    return np.array([written(sample, q) for sample, q in zip(samples, inputs[:, POSITION], strict=True)])


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
    found, wanted = run(lowered, inputs, state), expected(law, T, inputs, speed)
    peak = np.max(np.abs(wanted))
    assert np.max(np.abs(found.output - wanted)) <= 1e-9 * peak
    acts = np.mean(found.excess != 0.0, axis=0)
    return float(acts[lowered.output]), float(np.sum(acts) - acts[lowered.output])


PLAIN: dict[str, Cascade | PD] = {
    "P-P": Cascade(position_gain=60.0, velocity_gain=900.0),
    "P-PI": Cascade(position_gain=60.0, velocity_gain=900.0, integral_gain=40.0),
    "PD": PD(position_gain=4e3, derivative_gain=60.0),
    "PID": PID(position_gain=4e3, integral_gain=9e4, derivative_gain=60.0),
}
PARTS: dict[str, dict[str, Any]] = {
    "two-sample mean": {"velocity_filter": (0.5, 0.5)},
    "first order": {"velocity_filter": FirstOrder(2e-3)},
    "second order": {"velocity_filter": SecondOrder(100.0)},
    "moving average": {"velocity_filter": MovingAverage(7)},
    "low-pass and notch": {"torque_filters": (SecondOrder(150.0), Notch(80.0, 40.0, 0.2))},
    "acceleration": {"acceleration_feedforward": 0.1, "reference_delay": 1.3e-3},
    "viscous": {"viscous_feedforward": 5.0},
    "Coulomb": {"coulomb_feedforward": 4.0, "reference_delay": 2.5e-3},
    "constant": {"constant_feedforward": -2.5, "gain": 2.0},
    "reference delay": {"reference_delay": 2.7e-3},
    "reference velocity": {"reference_velocity": "channel", "reference_delay": 1.5e-3},
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("name", PLAIN)
def test_each_part_of_each_law_is_its_equation(name: str, part: str) -> None:
    check(replace(PLAIN[name], **PARTS[part]), seed=5)


OF_THE_CASCADE: dict[str, dict[str, Any]] = {
    "velocity feed-forward": {"velocity_feedforward": 0.9},
    "velocity channel, late": {
        "velocity_feedforward": 0.9, "reference_delay": 1.6e-3, "reference_velocity": "channel",
    },
    "slow": {"position_period": 8e-3, "velocity_feedforward": 0.9},
    "slow, later": {"position_period": 8e-3, "position_offset": 3e-3, "velocity_feedforward": 0.9},
    "slow, limited": {"position_period": 4e-3, "position_offset": 13e-3, "velocity_limit": 0.02},
    "velocity limit": {"velocity_limit": 0.02},
}  # fmt: skip


@pytest.mark.parametrize("part", OF_THE_CASCADE)
def test_each_part_of_the_cascade_is_its_equation(part: str) -> None:
    _, others = check(
        replace(Cascade(position_gain=60.0, velocity_gain=900.0, integral_gain=40.0), **OF_THE_CASCADE[part]), seed=6
    )
    assert (others > 0.1) == ("velocity_limit" in OF_THE_CASCADE[part])


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
    assert (
        not PD(position_gain=1.0, derivative_gain=1.0, velocity_filter=DigitalFilter((0.5,), (1.0, -1.0, 0.5)))
        .law(T)
        .integrates
    )
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


# What cannot be
