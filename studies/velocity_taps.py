"""Success rate of controller learning where the velocity is a weighted difference: random servos of up to 8 taps.

The axis is rigid, its servo a PD law on the position's error, or with damping on the position alone. An encoder rounds
what the log shows, and in every second servo what the law reads, too; the torque's log has 0.1 % of noise. The joint is
identified from torque and reference under the true law and under the learned one.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.controller_id.learn import learn_controller
from jointid.controller_id.learned_controller import LearnedController
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.structures import INTEGRAL
from jointid.diagnostics.identify import identify
from jointid.models.controllers import PD, Controller
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Channel, Record, Timing
from jointid.simulation.excitation import trapezoids
from studies.seeds import judge_seeds, parse_seeds

_PERIOD = 1e-3
_SAMPLES = 8_000
_NOISE = 1e-3  # of the torque's rms
_CLOSE = (
    1e-2  # of the torque's rms: two laws whose torque differs by less are one; wrong ones are some 2 % apart or more
)


@dataclass(frozen=True, slots=True, eq=False)
class TapsTwin:
    """A servo with a weighted difference, and its record.

    Attributes:
        taps: weights of the last differences of the position.
        controller: the law.
        values: of the joint.
        record: with reference, torque and motor position.
        seen: (samples,) the position that the law read.
        inside: whether the encoder rounds what the law reads.
    """

    taps: tuple[float, ...]
    controller: PD
    values: dict[str, float]
    record: Record
    seen: FloatArray
    inside: bool


@dataclass(frozen=True, slots=True)
class TapsRun:
    """What was learned of one servo.

    Attributes:
        seed: of the servo.
        found: words of the structure.
        apart: rms difference of the learned law's torque from the true one's on what the law read, of its rms.
        fed: whether a feed-forward was learned, of which there is none.
        beside: by parameter, the estimate under the learned law less that under the true law, in the former's standard
            deviations.
        off: by parameter, the former less the truth, likewise.
        seconds: that the learning took.
    """

    seed: int
    found: str
    apart: float
    fed: bool
    beside: dict[str, float]
    off: dict[str, float]
    seconds: float

    @property
    def right(self) -> bool:
        """True if the learned law gives the true one's torque."""
        return self.apart < _CLOSE and not self.fed


def learn_servos(seeds: Sequence[int] = range(100), out: Path | None = None) -> tuple[TapsRun, ...]:
    """Learn the laws of random servos, and identify their joints under them.

    Args:
        seeds: of the servos.
        out: folder in which runs are kept, and found again.
    """
    return tuple(TapsRun(**run) for run in judge_seeds("studies.velocity_taps:judge", seeds, {}, out=out))


def judge(seed: int) -> TapsRun:
    """Learn the law of one servo, and identify its joint under it."""
    twin = taps_twin(seed)
    began = time.perf_counter()
    try:
        learned = learn_controller(twin.record)
    except JointidError as refused:
        return TapsRun(seed, str(refused)[:90], math.inf, False, {}, {}, time.perf_counter() - began)
    seconds = time.perf_counter() - began
    beside, off = _compare_joints(twin, learned)
    # A PD on the plain difference of the error is the P-P with full velocity feed-forward, and called so.
    fed = "feed-forward" in str(learned.structure).replace("full velocity feed-forward", "")
    return TapsRun(seed, str(learned.structure), _torque_apart(twin, learned), fed, beside, off, seconds)


def _torque_apart(twin: TapsTwin, learned: LearnedController) -> float:
    """Return by how much the learned law's torque differs on what the true law read."""
    seen = Channel(twin.seen, "m", _PERIOD, Timing.SAMPLED, "twin")
    log = prepare_loop_record(replace(twin.record, motor_position=seen))
    held = next((one.value for one in learned.numbers if one.name == INTEGRAL), 0.0)
    true = log.predict(twin.controller.law(_PERIOD))[20:]
    found = log.predict(learned.controller.law(_PERIOD), held, learned.structure.interpolation)[20:]
    return float(np.sqrt(np.mean((found - true) ** 2) / np.mean(true**2)))


def _compare_joints(twin: TapsTwin, learned: LearnedController) -> tuple[dict[str, float], dict[str, float]]:
    """Return the joint's estimate under the learned law less that under the true law, and less the truth."""

    def under(controller: Controller) -> dict[str, tuple[float, float]]:
        estimate = identify(
            twin.record.without("motor_position"), ClosedLoop(RigidJoint("prismatic"), controller), checks=False
        )
        return {p.name: (p.value or 0.0, p.stderr or math.inf) for p in estimate.params.rows}

    try:
        true, found = under(twin.controller), under(learned.controller)
    except JointidError:
        return {}, {}
    return (
        {name: (value - true[name][0]) / std for name, (value, std) in found.items() if name in twin.values},
        {name: (value - twin.values[name]) / std for name, (value, std) in found.items() if name in twin.values},
    )


def taps_twin(seed: int) -> TapsTwin:
    """Return a random servo whose velocity is a weighted difference, and its record.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 18])
    while True:
        made = _random_twin(rng, seed % 2 == 1)
        if made is not None:
            return made


def _random_twin(rng: np.random.Generator, inside: bool) -> TapsTwin | None:
    inertia, travel = 10 ** rng.uniform(-1, 2), 10 ** rng.uniform(-1, 0.5)
    taps = _taps(rng)
    inner = 2 * math.pi * math.exp(rng.uniform(math.log(8), math.log(30)))
    outer = inner / rng.uniform(2.5, 5.0)
    controller = PD(
        position_gain=inertia * inner * outer,
        derivative_gain=inertia * inner,
        velocity_filter=taps,
        reference_velocity="difference" if rng.random() < 0.6 else "none",
    )
    reference = _reference(rng, travel)
    size = inertia * travel
    values = {"inertia": inertia, "viscous": 0.0, "coulomb": size * rng.uniform(0.3, 2.0)}
    values["offset"] = values["coulomb"] * rng.uniform(-0.3, 0.3)
    step = travel * 10 ** rng.uniform(-6.5, -5.0)
    torque, position = _drive(controller, taps, reference, values, step if inside else 0.0)
    if not np.all(np.isfinite(torque)) or np.max(np.abs(position - reference)) > 0.5 * travel or _rings(torque):
        return None
    torque = torque + _NOISE * float(np.std(torque)) * rng.standard_normal(torque.size)
    logged = np.round(position / step) * step
    record = Record(
        torque=Channel(torque, "N", _PERIOD, Timing.HELD, "twin"),
        reference=Channel(reference, "m", _PERIOD, Timing.SAMPLED, "twin"),
        motor_position=Channel(logged, "m", _PERIOD, Timing.SAMPLED, "twin"),
        name="twin",
    )
    return TapsTwin(taps, controller, values, record, logged if inside else position, inside)


def _taps(rng: np.random.Generator) -> tuple[float, ...]:
    """Return weights of 1 to 8 differences: all alike, of a least-squares line, at random, or with some negative."""
    n, kind = int(rng.integers(1, 9)), int(rng.integers(4))
    weights = [
        np.ones(n),
        np.arange(1, n + 1) * np.arange(n, 0, -1),
        rng.uniform(0.1, 1.0, n),
        rng.uniform(-0.3, 1.0, n) + 0.3,
    ][kind].astype(np.float64)
    return tuple(map(float, weights / weights.sum()))


def _reference(rng: np.random.Generator, travel: float) -> FloatArray:
    speeds = tuple(travel * rng.uniform(0.3, 2.5, 3))
    reference = trapezoids(speeds, travel * rng.uniform(4.0, 12.0), travel, _PERIOD, 0.1, _SAMPLES * _PERIOD)
    window = np.hanning(2 * int(rng.integers(5, 30)) + 1)
    padded = np.pad(reference, window.size // 2, mode="edge")
    return np.asarray(np.convolve(padded, window / window.sum(), "valid"))


def _drive(
    law: PD, taps: tuple[float, ...], reference: FloatArray, values: dict[str, float], step: float
) -> tuple[FloatArray, FloatArray]:
    """Return torque and position: a mass with Coulomb friction, exact, whose law reads a rounded position."""
    mass, friction, offset = values["inertia"], values["coulomb"], values["offset"]
    q, v = float(reference[0]), 0.0
    tracked = law.reference_velocity == "difference"
    differences, before_q, before_r = [0.0] * len(taps), q, q
    torque, position = np.empty(reference.size), np.empty(reference.size)
    for k, r in enumerate(map(float, reference)):
        read = round(q / step) * step if step else q
        moved = read - before_q - (r - before_r if tracked else 0.0)
        before_q, before_r = read, r
        differences = [moved / _PERIOD, *differences[:-1]]
        speed = sum(h * d for h, d in zip(taps, differences, strict=True))
        u = law.position_gain * (r - read) - law.derivative_gain * speed
        torque[k], position[k] = u, q
        if not math.isfinite(u) or abs(q) > 1e3:
            return np.full(reference.size, math.nan), position
        q, v = _move(q, v, u - offset, friction, mass)
    return torque, position


def _move(q: float, v: float, force: float, friction: float, mass: float) -> tuple[float, float]:
    """Return position and velocity a period later."""
    left = _PERIOD
    while left > 0.0:
        if v == 0.0:
            if abs(force) <= friction:
                return q, 0.0
            a = (force - math.copysign(friction, force)) / mass
            return q + 0.5 * a * left**2, a * left
        a = (force - math.copysign(friction, v)) / mass
        stop = -v / a if a * v < 0 else math.inf
        if stop >= left:
            return q + v * left + 0.5 * a * left**2, v + a * left
        q, v, left = q + 0.5 * v * stop, 0.0, left - stop
    return q, v


def _rings(torque: FloatArray) -> bool:
    return float(np.std(np.diff(torque)[-1500:])) > 3 * float(np.std(np.diff(torque)[:5000]))


def _main() -> None:
    """Show the runs of the seeds ``python -m studies.velocity_taps [FIRST AFTER_LAST]``, 0 to 99 unless told."""
    given = parse_seeds(_main.__doc__, 100)
    runs = learn_servos(given.seeds, given.out)
    inside = [abs(z) <= 2.0 for one in runs for z in one.beside.values()]
    covered = [abs(z) <= 2.0 for one in runs for z in one.off.values()]
    sys.stdout.write(
        f"{sum(one.right for one in runs)} of {len(runs)} learned, {sum(one.fed for one in runs)} with a feed-forward "
        f"that is not there; the joint within 2 sigma of the true law's in {100 * np.mean(inside):.1f} %, of the truth "
        f"in {100 * np.mean(covered):.1f} %\n"
    )


if __name__ == "__main__":
    _main()
