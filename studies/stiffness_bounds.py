"""Stiffness bounds, refusals and values on random drives whose load friction and damping nothing knows beforehand.

Each plant is another drive: 8 to 80 Hz, or faster; a spring damped by 0.3 to 10 %; any part of the friction on the
load's side; P-P, P-PI and PID loops; trapezoids, a sweep or a multisine, lively or slow; white noise on the log, or a
coloured force in the loop. It is identified from torque and reference, and ends in a stiffness with an interval or in a
refusal with bounds. Its load share is one of those for which bounds are given, so that a bound and the truth compare.

What could be known of the spring is predicted at the truth, as in `studies.refusals`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.identify import identify
from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.result.springs import SHARES
from jointid.estimation.spring_search import on_band
from jointid.models.controllers import PID, Cascade, Controller
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from jointid.tuning.margins import joint_set
from jointid.uncertainty.covariance import Influence

PLAIN, INVISIBLE = 0.03, 0.5  # predicted deviations of K12: below, it must be reported; above, it must not
SLOW = 80.0  # Hz: bounds are counted for modes below it apart
_PERIOD = 1e-3
_STABLE = 0.1  # the least distance to instability of a loop that is drawn


@dataclass(frozen=True, slots=True, eq=False)
class BoundedPlant:
    """A random drive under its loop, its motion and its noise.

    Attributes:
        loop: of joint and controller. truth: the joint's parameters. mode, share, ratio: free-free, Hz, of the load in
            the inertia, and of damping. motion: its name. record: torque and reference, with the noise.
        noise: "white" on the log, or "force" in the loop; level: of it in the torque's variation.
    """

    loop: ClosedLoop
    truth: dict[str, float]
    mode: float
    share: float
    ratio: float
    motion: str
    record: Record
    noise: str
    level: float


@dataclass(frozen=True, slots=True)
class BoundRun:
    """One plant: what could be known of its spring, and what was said.

    Attributes:
        seed: of the plant. mode: Hz, free-free, true. stiffness: true.
        predicted: relative standard deviation of the stiffness at the truth.
        value, std: None where it was refused.
        bound: of a refused one, at the true load share; None where the record bounds nothing.
        simulations: of the identification.
        error: what was said in place of an answer.
    """

    seed: int
    mode: float
    stiffness: float
    predicted: float
    value: float | None = None
    std: float | None = None
    bound: float | None = None
    simulations: int = 0
    error: str = ""

    @property
    def refused(self) -> bool:
        """True if no value was given."""
        return self.value is None and not self.error

    @property
    def violated(self) -> bool:
        """True if the spring is softer than the bound."""
        return self.refused and self.bound is not None and self.bound > self.stiffness


def identify_plant(seed: int) -> BoundRun:
    """Identify one plant from torque and reference alone."""
    plant = random_plant(seed)
    run = BoundRun(seed, plant.mode, plant.truth["stiffness"], _predict(plant))
    try:
        estimate = identify(plant.record, plant.loop, checks=False)
    except JointidError as error:
        return replace(run, error=str(error))
    run = replace(run, simulations=estimate.fit.simulations)
    spring = estimate["stiffness"]
    if spring.value is None:
        return replace(run, bound={b.share: b.stiffness for b in estimate.bounds}.get(plant.share))
    return replace(run, value=spring.value, std=spring.stderr)


def _predict(plant: BoundedPlant) -> float:
    """Return the relative standard deviation of the stiffness, from sensitivities and noise at the truth."""
    problem = torque_problem(plant.record, plant.loop, Filtering(), plant.loop.joint.parameters)
    problem = on_band(problem.keeping({"initial_velocity": 0.0}), Filtering(), plant.mode)
    truth = problem.vector({"initial_position": 0.0, "initial_torque": 0.0} | plant.truth)
    error, J = problem.linearise(truth)
    names = [p.name for p in problem.free]
    at = names.index("stiffness")
    return float(Influence(J, error).robust().std[at] / truth[at])


def random_plant(seed: int) -> BoundedPlant:
    """Return a random drive whose loop is stable, and its record; 5 to 10 s at 1 kHz.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 18])
    while True:
        found = _drawn(rng)
        if found is not None:
            return found


def _drawn(rng: np.random.Generator) -> BoundedPlant | None:
    inertia = 10 ** rng.uniform(-2, 2)
    low, high = (8.0, SLOW) if rng.random() < 0.7 else (SLOW, 300.0)
    mode = math.exp(rng.uniform(math.log(low), math.log(high)))
    share, ratio = float(rng.choice(SHARES)), math.exp(rng.uniform(math.log(0.003), math.log(0.1)))
    crossover = min(mode, 60.0) * rng.uniform(0.1, 0.4)
    duration, swing = rng.uniform(5.0, 10.0), 10 ** rng.uniform(-1, 1)
    motion = str(rng.choice(["trapezoid", "sweep", "multisine"]))
    lively = math.exp(rng.uniform(math.log(0.1), math.log(1.0)))  # of the crossover: how fast the motion is
    reference = _moved(rng, motion, lively * crossover, swing, duration)
    acceleration = np.diff(reference, 2) / _PERIOD**2
    force = inertia * float(np.percentile(np.abs(acceleration), 95))
    speed = float(np.max(np.abs(np.diff(reference)))) / _PERIOD
    reduced, rate = share * (1 - share) * inertia, 2 * math.pi * mode
    coulomb, viscous = force * rng.uniform(0.05, 0.3), force * rng.uniform(0.02, 0.15) / speed
    on_load = rng.uniform(0.0, 1.0, 2)
    truth = {
        "motor_inertia": (1 - share) * inertia,
        "motor_viscous": (1 - on_load[0]) * viscous,
        "motor_coulomb": (1 - on_load[1]) * coulomb,
        "stiffness": reduced * rate**2,
        "damping": 2 * ratio * reduced * rate,
        "load_inertia": share * inertia,
        "load_viscous": on_load[0] * viscous,
        "load_coulomb": on_load[1] * coulomb,
        "offset": rng.uniform(-0.1, 0.1) * force,
    }
    truth = {name: float(value) for name, value in truth.items()}
    loop = ClosedLoop(FlexibleJoint(kind="revolute"), _controller(rng, inertia, crossover))
    law = loop.controller.law(_PERIOD)
    if joint_set(loop.joint, [truth], law).margins(law)[0, -1] < _STABLE:
        return None
    noise, level = str(rng.choice(["white", "force"])), math.exp(rng.uniform(math.log(0.005), math.log(0.2)))
    white = rng.standard_normal(reference.size)

    def logged(disturbance: FloatArray | None = None, torque_noise: FloatArray | None = None) -> Record:
        made = simulated_record(
            loop, reference, truth, sample_time=_PERIOD, disturbance=disturbance, torque_noise=torque_noise, name="twin"
        )
        return made.without("motor_position", "load_position")

    def torque(record: Record) -> FloatArray:
        assert record.torque is not None
        return record.torque.values

    clean = torque(logged())
    size = level * float(np.std(clean))
    if noise == "white":
        record = logged(torque_noise=size * white)
    else:
        coloured = _coloured(white, rng.uniform(0.0, 0.98))
        small = 1e-3 * float(np.std(clean)) * coloured
        record = logged(disturbance=small * size / float(np.std(torque(logged(small)) - clean)))
    return BoundedPlant(loop, truth, mode, share, ratio, motion, record, noise, level)


def _coloured(white: FloatArray, memory: float) -> FloatArray:
    """Return noise of variance 1 that forgets by `memory` from sample to sample, (samples,)."""
    from scipy.signal import lfilter

    found = lfilter([math.sqrt(1 - memory**2)], [1.0, -memory], white)
    return np.asarray(found)


def _moved(rng: np.random.Generator, motion: str, hertz: float, swing: float, duration: float) -> FloatArray:
    """Return a reference, (samples,), that moves with frequencies up to about `hertz`."""
    count = math.floor(duration / _PERIOD)
    at = np.arange(count) * _PERIOD
    if motion == "trapezoid":
        speed = swing * hertz
        return trapezoids((0.35 * speed, 0.7 * speed, speed), 4 * speed * hertz, swing, _PERIOD, duration=duration)
    ends = np.minimum(np.minimum(at, at[-1] - at) / (0.05 * duration), 1.0)
    window = ends**2 * (3 - 2 * ends)
    if motion == "sweep":
        first, last = 0.3, 2 * hertz
        pace = math.log(last / first) / duration
        return np.asarray(window * 0.2 * swing * np.sin(2 * math.pi * first * np.expm1(pace * at) / pace))
    lines = np.geomspace(0.3, 2 * hertz, 12)
    phases = rng.uniform(0, 2 * math.pi, lines.size)
    waves = np.sin(2 * math.pi * np.outer(at, lines) + phases) / lines
    return np.asarray(window * 0.2 * swing * waves.sum(axis=1))


def _controller(rng: np.random.Generator, inertia: float, crossover: float) -> Controller:
    rate, kind = 2 * math.pi * crossover, str(rng.choice(["P-P", "P-PI", "PID"]))
    if kind == "PID":
        derivative = inertia * rate
        return PID(
            position_gain=derivative * 0.25 * rate, derivative_gain=derivative,
            integral_gain=derivative * rate**2 * rng.uniform(0.01, 0.04),
        )  # fmt: skip
    integral = rate * rng.uniform(0.05, 0.2) if kind == "P-PI" else 0.0
    return Cascade(position_gain=0.25 * rate, velocity_gain=inertia * rate, integral_gain=integral)
