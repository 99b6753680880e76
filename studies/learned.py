"""Success rate of controller learning: random loops of every law, learned from noisy records."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.controller_id.learn import SAME, learn_controller
from jointid.controller_id.structures import ACCELERATION, INTEGRAL, Structure, canonical, controller
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Record, Tap
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulated_record

_PERIOD = 1e-3
_SAMPLES = 10_000


@dataclass(frozen=True, slots=True, eq=False)
class LoopTwin:
    """A loop of known structure, and its record.

    Attributes:
        structure: of the law.
        numbers: of the law, in the structure's names.
        record: with reference, torque and motor position, all noisy but the reference.
    """

    structure: Structure
    numbers: dict[str, float]
    record: Record


@dataclass(frozen=True, slots=True)
class LearnedRun:
    """One run: the law there was, and the one that was learned.

    Attributes:
        seed: of the twin.
        true: words of the true structure, under its canonical name. found: of the one that was learned.
        right: whether they are the same, or two names of one equation: the true structure fits, too, and its torque is
            that of the learned law but for rounding. named: whether the true one is at least among those that are said
            to be alike.
        alike: how many are said to be alike.
        deviations: of the numbers from the true ones, in standard deviations; none where the law was drawn or learned
            under another name than its canonical one.
        seconds: that it took.
    """

    seed: int
    true: str
    found: str
    right: bool
    named: bool
    alike: int
    deviations: tuple[float, ...]
    seconds: float


def judge(seed: int) -> LearnedRun:
    """Learn the controller of one twin."""
    made = loop_twin(seed)
    begin = time.perf_counter()
    learned = learn_controller(made.record)
    seconds = time.perf_counter() - begin
    true = canonical(made.structure)
    same = str(learned.structure) == str(true)
    right = same or any(str(one.structure) == str(true) and one.apart < SAME for one in learned.alternatives)
    named = any(str(one.structure) == str(true) for one in learned.alternatives)
    known = made.numbers if same and true == made.structure else {}
    deviations = tuple((learned[n].value - known[n]) / learned[n].std for n in known if n != INTEGRAL)
    return LearnedRun(
        seed, str(true), str(learned.structure), right, named, len(learned.alternatives), deviations, seconds
    )


def loop_twin(seed: int) -> LoopTwin:
    """Return a random loop and its record: any law, bandwidths of 5 to 40 Hz, an encoder and a log that round.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 7])
    while True:
        made = _random_twin(rng)
        if made is not None:
            return made


def _random_twin(rng: np.random.Generator) -> LoopTwin | None:
    inertia, travel = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-1, 0.5)
    structure, numbers = _law(rng, inertia)
    reference = _reference(rng, travel)
    size = inertia * travel  # N at 1/s^2
    values = {
        "inertia": inertia,
        "viscous": size / travel * rng.uniform(0.2, 2.0),
        "coulomb": size * rng.uniform(0.3, 2.0),
        "offset": size * rng.uniform(-0.3, 0.3),
    }
    known = pulses(reference.size, _PERIOD, height=5 * size, width=0.02, every=0.4, seed=int(rng.integers(1 << 30)))
    loop = ClosedLoop(RigidJoint("prismatic"), controller(structure, numbers, _PERIOD, 1.0))
    tap = Tap.MEASURED if structure.late else Tap.COMMAND
    try:
        record = simulated_record(
            loop, reference, values, sample_time=_PERIOD, injected=known, tap=tap, name="twin",
            encoder_step=travel * 10 ** rng.uniform(-6.5, -5.0), initial=Initial(),
        )  # fmt: skip
    except MethodError:
        return None
    assert record.torque is not None and record.motor_position is not None
    torque = record.torque.values
    if np.max(np.abs(record.motor_position.values - reference)) > 0.5 * travel or _rings(torque):
        return None
    noise = float(np.std(torque)) * 10 ** rng.uniform(-3.5, -2.3) * rng.standard_normal(torque.size)
    return LoopTwin(structure, numbers, replace(record, torque=replace(record.torque, values=torque + noise)))


def _rings(torque: FloatArray) -> bool:
    return float(np.std(np.diff(torque)[-1500:])) > 3 * float(np.std(np.diff(torque)[:5000]))


def _reference(rng: np.random.Generator, travel: float) -> FloatArray:
    speeds = tuple(travel * rng.uniform(0.3, 2.5, 3))
    reference = trapezoids(speeds, travel * rng.uniform(4.0, 12.0), travel, _PERIOD, 0.1, _SAMPLES * _PERIOD)
    window = np.hanning(2 * int(rng.integers(5, 30)) + 1)  # a jerk that is limited
    padded = np.pad(reference, window.size // 2, mode="edge")
    return np.asarray(np.convolve(padded, window / window.sum(), "valid"))


def _law(rng: np.random.Generator, inertia: float) -> tuple[Structure, dict[str, float]]:
    law = str(rng.choice(["P-P", "P-PI", "PD", "PID"]))
    cascade, integral = law in ("P-P", "P-PI"), law in ("P-PI", "PID")
    velocity = str(rng.choice(["none", "share", "full"] if cascade else ["difference", "none"][: 1 + integral]))
    filters = ["none", "mean 2", "mean 4", "first order", "second order"]
    filtered = str(rng.choice(filters, p=[0.25, 0.25, 0.1, 0.25, 0.15]))
    parts = {part for part in ("acceleration", "coulomb") if rng.random() < 0.3}
    structure = Structure(law, velocity, filtered, frozenset(parts))  # type: ignore[arg-type]
    extra = str(
        rng.choice(["none", "torque", "reference", "late", "rate", "every"], p=[0.45, 0.15, 0.1, 0.1, 0.1, 0.1])
    )
    if extra == "torque":
        structure = replace(structure, torque_filter=str(rng.choice(["first order", "second order", "notch"])))
    if extra == "reference":
        structure = replace(structure, reference_delay=True)
    if extra == "late":
        structure = replace(structure, late=int(rng.integers(1, 4)))
    if extra == "rate":
        # Of lines an acceleration is all jerks, where they meet: between the log's samples, where no log shows it.
        structure = replace(
            structure, rate=int(rng.choice([2, 4, 8])), interpolation="cubic" if ACCELERATION in parts else "linear"
        )
    if extra == "every" and cascade:
        every = int(rng.choice([2, 4, 8]))
        structure = replace(structure, every=every, offset=int(rng.integers(every)))
    return structure, _numbers(rng, structure, inertia)


def _numbers(rng: np.random.Generator, structure: Structure, inertia: float) -> dict[str, float]:
    inner = 2 * math.pi * math.exp(rng.uniform(math.log(10), math.log(40)))  # rad/s
    outer, slow = inner / rng.uniform(2.5, 5.0), inner / rng.uniform(5, 20)
    cascade = {"position_gain": outer, "velocity_gain": inertia * inner, "integral_gain": slow}
    others = {
        "position_gain": inertia * inner * outer,
        "derivative_gain": inertia * inner,
        "integral_gain": inertia * inner * outer * slow / 3,
    }
    beside = {
        "velocity_feedforward": rng.uniform(0.5, 1.0),
        "acceleration_feedforward": inertia * rng.uniform(0.5, 1.0),
        "coulomb_feedforward": inertia * rng.uniform(0.3, 1.0),
        "velocity_filter.time_constant": 10 ** rng.uniform(-3.2, -2.5),
        "velocity_filter.frequency": rng.uniform(80, 250),
        "velocity_filter.damping": rng.uniform(0.5, 1.0),
        "torque_filters.0.time_constant": 10 ** rng.uniform(-3.2, -2.7),
        "torque_filters.0.frequency": rng.uniform(80, 200),
        "torque_filters.0.damping": rng.uniform(0.5, 1.0),
        "torque_filters.0.bandwidth": rng.uniform(20, 60),
        "torque_filters.0.depth": rng.uniform(0.0, 0.3),
        "reference_delay": rng.uniform(0.5e-3, 4e-3),
        "integral": 0.0,
    }
    known = (cascade if structure.cascade else others) | beside
    return {name: float(known[name]) for name in structure.names}
