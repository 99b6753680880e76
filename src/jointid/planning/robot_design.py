"""Design of the most informative motion of a robot within the limits of its joints.

Of a motion q the columns W(q) of base parameters and friction say what a test will tell: with white noise of deviation
s_k on the log of joint k's torque the deviations of all parameters are those of::

    M = sum_k W_k' W_k / s_k^2,      cov = M^-1

The search takes the motion with the largest log det M, whose intervals are smallest on the geometric mean [Swevers
et al. 1997, D-optimal]; no units and no choice of base parameters enter it. The motions are Fourier series (`motions`),
the search an evolution strategy (I. Rechenberg's rule of one success in five) over their numbers, in which a motion
that asks a joint for more torque than it has is worse than any that does not.

Of joints with springs a multisine about the mode of rotor against link is added, and the deviations of all
parameters, springs included, are predicted from the robot simulated under its controllers, with derivatives by
variation.

Obstacles, and the robot's own body, are not known here: play the motion slowly first.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.charts import MEASURED, SIMULATED, Chart, Line, Panel
from jointid.common.document import Document, Documented, Facts, Paragraph, Table
from jointid.common.errors import MethodError
from jointid.common.matplotlib_backend import Charted
from jointid.common.messages import Progress, ignore_progress
from jointid.common.text import join, number
from jointid.diagnostics.robots.torques import torques_of
from jointid.estimation.result.parts import EstimateParts
from jointid.estimation.robots.consistent import mass_matrix_at
from jointid.estimation.robots.numbers import robot_parameters
from jointid.estimation.robots.problem import robot_problem
from jointid.estimation.robots.regression import motion_of_robot
from jointid.estimation.robots.simulated import parameter_units
from jointid.models.limits import ROBOT_LIMITS, AxisLimits, find_excess
from jointid.models.robots.base_parameters import base_parameters, inverse_columns
from jointid.models.robots.friction_terms import Friction, friction_columns, friction_terms
from jointid.models.robots.robot import Robot
from jointid.planning.robot_motions import Motions, complete
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation import excitation
from jointid.simulation.robot_numbers import RobotNumbers
from jointid.simulation.robots import (
    RobotLoop,
    add_feed_forward,
    prepare_robot,
    run_robot,
)
from jointid.simulation.simulated import require_success
from jointid.simulation.synthesis import simulate

NOISE = 0.01
"""Of each joint's torque in motions drawn at random: the predicted noise without a first record."""

_HARMONICS = 8
_INSTANTS = 160  # of a period, at which columns are taken in the search
_DRAWN, _KEPT, _MOVES = 60, 4, 60  # motions to begin with, those that are moved, and how often
_USUAL = 20  # random motions, whose torques say what noise is usual
_FIRST_STEP, _GROWS, _SHRINKS, _SMALLEST = 0.4, 1.5, 0.9, 2e-3
_MOST = 20_000  # motions in all
_STUCK = 1_000  # without a gain: an end
_NOTHING = 1e6  # the score of a motion that does not tell all
_GAIN = 0.01  # of log det M, that counts as one
_INSIDE = 0.97  # of a torque that the nominal robot may take: another takes more
_FOR_MODES = 0.2  # of speed and acceleration, kept for the multisine where there are springs
_ABOUT = (0.6, 1.6)  # of a mode's frequency: the band of the multisine
_LINES = 20
_FEWEST = 200  # samples


@dataclass(frozen=True, slots=True, eq=False)
class RobotDesign(Charted, Documented):
    """A motion of a robot, and the predicted intervals of a test along it.

    Attributes:
        robot: as it is roughly known.
        sample_time: of the motion, s.
        reference: (samples, n) positions of the motors behind their gears, rad or m.
        torque: (samples, n) that the nominal robot needs for it, N m or N.
        names, units: of the parameters.
        values: (parameters,) of the nominal robot.
        std: (parameters,) predicted; infinite for a parameter that the motion does not determine.
        present_std: the same of the first record's motion; None without one.
        noise: (n,) standard deviation of the assumed white noise on the log of each torque.
        of_record: whether that is the noise of a first record.
        limits: that were kept.
        reached: of each joint, positions, speed, acceleration and torque.
        passed: clauses on limits that are passed; none as a rule.
        modes: Hz, of each flexible joint by its name.
        tried: motions.
    """

    robot: Robot
    sample_time: float
    reference: FloatArray
    torque: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    std: FloatArray
    present_std: FloatArray | None
    noise: FloatArray
    of_record: bool
    limits: tuple[AxisLimits, ...]
    reached: tuple[Mapping[str, float], ...]
    passed: tuple[str, ...]
    modes: dict[str, float]
    tried: int

    @property
    def allowed(self) -> tuple[dict[str, float | None], ...]:
        """Limits of each joint by name; None where there is none."""
        return tuple({name: getattr(one, name) for name in ROBOT_LIMITS} for one in self.limits)

    @property
    def well_known(self) -> tuple[str, ...]:
        """Names of the parameters that will be known to a tenth of the nominal value, one standard deviation."""
        return tuple(n for n, v, s in zip(self.names, self.values, self.std, strict=True) if s < 0.1 * abs(v))

    @property
    def parameters(self) -> Mapping[str, Mapping[str, float | str | None]]:
        """Nominal value, predicted deviations of this and the present motion, and unit, by name."""
        before = [None] * len(self.names) if self.present_std is None else [float(one) for one in self.present_std]
        return {
            name: {"about": float(value), "std": float(std), "present_std": present, "unit": unit}
            for name, value, std, present, unit in zip(
                self.names, self.values, self.std, before, self.units, strict=True
            )
        }

    @property
    def ratio(self) -> float | None:
        """Geometric mean of deviations relative to the present motion; None if one is infinite."""
        if self.present_std is None or not np.all(np.isfinite([self.std, self.present_std])):
            return None
        return float(np.exp(np.mean(np.log(self.std / self.present_std))))

    @property
    def sentence(self) -> str:
        """Predicted intervals in one sentence, compared with the present motion."""
        lasts = len(self.reference) * self.sample_time
        known = f"{len(self.well_known)} of {len(self.names)} parameters"
        stated = f"In {number(lasts, 3)} s this motion tells {known} to a tenth"
        if self.ratio is not None:
            stated += f", with intervals of {100 * self.ratio:.0f} % of the present motion's on the geometric mean"
        elif self.present_std is not None:
            stated += "; the present motion does not tell all"
        over = f" Beware: {'; '.join(self.passed)}." if self.passed else ""
        return f"{stated}.{over}"

    def to_document(self, *, details: bool = False) -> Document:
        """Return limits and predicted intervals; there are no further details."""
        del details
        header: tuple[str, ...] = ("parameter", "about", "2 sigma predicted", "of the present motion", "unit")
        rows = list[tuple[str, ...]]()
        for i, name in enumerate(self.names):
            before = "-" if self.present_std is None else _sigma(self.present_std[i])
            rows.append((name, number(float(self.values[i]), 4), _sigma(self.std[i]), before, self.units[i]))
        if self.present_std is None:
            header, rows = (*header[:3], header[4]), [(*row[:3], row[4]) for row in rows]
        joints: tuple[tuple[str, ...], ...] = tuple(
            (
                name,
                f"{number(reached['lower'], 3)} to {number(reached['upper'], 3)} {self.robot.position_unit(k)}",
                *(
                    number(reached[what], 3)
                    if getattr(self.limits[k], what) is None
                    else f"{number(reached[what], 3)} of {number(getattr(self.limits[k], what), 3)}"
                    for what in ROBOT_LIMITS[2:]
                ),
            )
            for k, (name, reached) in enumerate(zip(self.robot.names, self.reached, strict=True))
        )  # fmt: skip
        source = (
            "as the first record's residual" if self.of_record else f"{100 * NOISE:g} % of each joint's usual torque"
        )
        searched = f"{self.tried} motions were tried" if self.tried > 1 else "none: one motion was predicted"
        facts = [("noise", f"white, {source}"), ("search", searched)]
        if self.modes:
            each = ", ".join(f"{name} {number(hertz, 3)} Hz" for name, hertz in self.modes.items())
            facts.append(("multisines", f"about the modes of {each}"))
        return Document(
            f"{self.robot.name}: the next test",
            (
                Paragraph(self.sentence, lead=True, tone="bad" if self.passed else "good"),
                Paragraph("Neither obstacles nor the robot's own body are known here: play it slowly first."),
                Table(
                    ("joint", "positions", "speed", "acceleration", "torque"), joints,
                    "what the motion reaches, of what is allowed", (0, 1, 2, 3, 4),
                ),
                Table(header, tuple(rows), "predicted intervals", (0, len(header) - 1)),
                Facts(tuple(facts)),
            ),
        )  # fmt: skip

    def chart(self) -> Chart:
        """Return reference and torque of each joint over time."""
        t, panels = np.arange(len(self.reference)) * self.sample_time, []
        for k, name in enumerate(self.robot.names):
            for values, unit, word, colour in (
                (self.reference, self.robot.position_unit(k), "reference", MEASURED),
                (self.torque, self.robot.torque_unit(k), "predicted torque", SIMULATED),
            ):
                line = Line(np.asarray(t), values[:, k], colour)
                panels.append(Panel("time [s]", f"{name}, {word} [{unit}]", (line,), height=180))
        return Chart("motion", "What is to be played, and the torque that the nominal robot needs for it.",
                     tuple(panels), columns=2)  # fmt: skip

    def records(self) -> tuple[Record, ...]:
        """Return the motion as a record of each joint, with its reference."""
        return _references(self.robot, self.reference, self.sample_time)


def design_robot_test(
    robot: Robot,
    limits: Sequence[AxisLimits],
    *,
    duration: float = 10.0,
    sample_time: float = 1e-3,
    loop: RobotLoop | None = None,
    feed_forward: Literal["none", "gravity", "inverse-model"] = "none",
    noise: Sequence[float] | FloatArray | None = None,
    present: tuple[FloatArray, FloatArray, FloatArray] | None = None,
    motion: FloatArray | None = None,
    filtering: Filtering | None = None,
    harmonics: int = _HARMONICS,
    seconds: float = 60.0,
    seed: int = 0,
    progress: Progress = ignore_progress,
) -> RobotDesign:
    """Design the test of a robot that is roughly known; see `jointid.design`.

    `duration` is one period of the series. `present` are positions, velocities and accelerations of the joints in a
    first record, (samples, n) each, at the sample time, `motion` positions that are predicted instead of a search.
    """
    if any(robot.flexible) and loop is None:
        raise MethodError(
            "The intervals of springs are predicted under the controllers, and there are none; give every joint its "
            "controller, or leave the springs out."
        )
    samples = round(duration / sample_time)
    if samples < _FEWEST:
        raise MethodError(f"A test of {samples} samples tells nothing; expected {_FEWEST} or more: plan a longer one.")
    if len(limits) != len(robot):
        raise MethodError(f"A robot of {len(robot)} joints has as many limits; received {len(limits)}.")
    positions, velocities = (None, None) if present is None else present[:2]
    given = tuple(limits) if motion is not None else complete(limits, positions, velocities, robot.names)
    model = _Regressor.of(robot)
    sizes = None if noise is None else np.asarray(noise, dtype=np.float64)
    time, tried, flexible = np.arange(samples) * sample_time, 1, any(robot.flexible)
    modes: dict[str, float] = {}
    if motion is None:
        motions = Motions(given, samples * sample_time, harmonics, 1.0 - _FOR_MODES if flexible else 1.0)
        sizes = _usual(model, motions, seed) if sizes is None else sizes
        score = _score(model, motions, sizes, given)
        found, tried = _search(motions, score, seconds, seed, progress)
        q, v, a = motions.play(found, motions.bases(np.asarray(time)), motions.whole)
        if flexible:
            modes = _modes(robot, q)
            q = q + _multisines(robot, modes, given, samples, sample_time)
            v = np.gradient(q, sample_time, axis=0)
            a = np.gradient(v, sample_time, axis=0)
    else:
        q = np.asarray(motion, dtype=np.float64)
        v = np.gradient(q, sample_time, axis=0)
        a = np.gradient(v, sample_time, axis=0)
    torque = model.torque(q, v, a)
    of_noise = NOISE * np.sqrt(np.mean(torque**2, axis=0)) if sizes is None else sizes
    reference = q @ robot.coupling.T
    if loop is None:
        names, units, values = model.names, model.units, model.values
        std = model.deviations(q, v, a, of_noise)
        before = None if present is None else model.deviations(*present, of_noise)
    else:

        def predict(played: FloatArray) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray, FloatArray]:
            driven = _references(robot, played, sample_time)
            if feed_forward != "none":
                driven = add_feed_forward(loop, driven, feed_forward)
            return _by_simulation(loop, driven, of_noise, filtering)

        names, units, values, std = predict(reference)
        before = None if present is None else predict(present[0] @ robot.coupling.T)[3]
    most = [q.min(axis=0), q.max(axis=0), *(np.abs(one).max(axis=0) for one in (v, a, torque))]
    reached = tuple(dict(zip(ROBOT_LIMITS, map(float, of_joint), strict=True)) for of_joint in zip(*most, strict=True))
    over = [list(find_excess(*one)) for one in zip(given, reached, strict=True)]
    passed = tuple(
        f"{name} passes its limit of {join(one)}" for name, one in zip(robot.names, over, strict=True) if one
    )
    return RobotDesign(
        robot, sample_time, reference, torque, names, units, values, std, before, of_noise, noise is not None, given,
        reached, passed, modes, tried,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class FirstRecord:
    """Noise and motion of a first record, as `design_robot_test` takes them.

    Attributes:
        noise: (n,) deviation of white noise on each joint's log that has as much in the band of the filter as the
            estimate left.
        motion: positions, velocities and accelerations of the joints, (samples, n) each; of a test by DIDIM those of
            the references.
        sample_time: s.
    """

    noise: FloatArray
    motion: tuple[FloatArray, FloatArray, FloatArray]
    sample_time: float

    @property
    def duration(self) -> float:
        """Of the record, s."""
        return len(self.motion[0]) * self.sample_time


def first_record(estimate: EstimateParts, records: Sequence[Record]) -> FirstRecord:
    """Summarise a record and its estimate for the next test.

    Args:
        estimate: of the robot.
        records: of each joint, that it was identified from.

    Raises:
        RecordError, MethodError: as of the identification.
    """
    torques, robot = torques_of(estimate, records), estimate.require_robot().model
    left = np.array([np.sqrt(np.mean(e[s] ** 2)) for e, s in zip(torques.error, torques.seen, strict=True)])
    if estimate.settings.method != "didim":
        found = motion_of_robot(robot, records, estimate.settings.filtering)
        motion, sample_time = (found.q, found.v, found.a), found.sample_time
    else:
        references = [record.reference for record in records if record.reference is not None]
        sample_time = references[0].sample_time
        q = np.column_stack([one.values for one in references]) @ np.linalg.inv(robot.coupling).T
        v = np.gradient(q, sample_time, axis=0)
        motion = q, v, np.gradient(v, sample_time, axis=0)
    # White noise has in the band the share 2 cutoff / rate of its power.
    return FirstRecord(left * np.sqrt(0.5 / (sample_time * torques.cutoff)), motion, sample_time)


@dataclass(frozen=True, slots=True, eq=False)
class _Regressor:
    """Columns of a rigid robot's torques, and its own parameters.

    Attributes:
        robot: as it is roughly known.
        names, units, values: of its base parameters, then of its friction, as IDIM tells it.
        chosen: see `BaseParameters`.
    """

    robot: Robot
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: FloatArray
    chosen: NDArray[np.intp]

    @classmethod
    def of(cls, robot: Robot) -> _Regressor:
        base = base_parameters(robot)
        values = base.with_friction(robot)
        terms = friction_terms(robot)
        for i, term in enumerate(terms):
            spring = robot.joints[term.joint].spring
            if spring is not None and term.number is not Friction.OFFSET and term.number is not Friction.RISE:
                values[len(base) + i] += spring.coulomb if term.number is Friction.COULOMB else spring.viscous
        units = (*base.units, *(term.unit(robot) for term in terms))
        return cls(robot, (*base.names, *(term.name(robot) for term in terms)), units, values, base.chosen)

    def columns(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the columns at instants, (instants, n, parameters)."""
        links = inverse_columns(self.robot, q, v, a)[:, :, self.chosen]
        return np.concatenate([links, friction_columns(self.robot, v)], axis=2)

    def torque(self, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        """Return the nominal robot's torques, (instants, n)."""
        return np.asarray(self.columns(q, v, a) @ self.values)

    def deviations(self, q: FloatArray, v: FloatArray, a: FloatArray, noise: FloatArray) -> FloatArray:
        """Return the standard deviations of all parameters, (parameters,), under white noise of sizes (n,)."""
        columns = self.columns(q, v, a) / noise[:, np.newaxis]
        return _deviations(columns.reshape(-1, columns.shape[2]))


def _deviations(J: FloatArray) -> FloatArray:
    """Return the deviations of least squares on rows of deviation 1, (parameters,); infinite if not determined."""
    norms = np.linalg.norm(J, axis=0)
    seen = norms > 0.0
    found = np.full(J.shape[1], np.inf)
    R = np.linalg.qr(J[:, seen] / norms[seen], mode="r")
    sizes = np.linalg.svd(R, compute_uv=False)
    if sizes.size and sizes[-1] > 1e-10 * sizes[0]:
        found[seen] = np.linalg.norm(np.linalg.inv(R), axis=1) / norms[seen]
    return found


def _usual(model: _Regressor, motions: Motions, seed: int) -> FloatArray:
    """Return the noise of joints of which nothing is known, (n,): a share of their torques in random motions."""
    seen, whole = motions.bases(np.linspace(0.0, motions.period, _INSTANTS, endpoint=False)), motions.whole
    rng = np.random.default_rng(seed)
    torques = [model.torque(*motions.play(motions.draw(rng), seen, whole)) for _ in range(_USUAL)]
    return np.asarray(NOISE * np.sqrt(np.mean(np.square(torques), axis=(0, 1))))


def _score(
    model: _Regressor, motions: Motions, noise: FloatArray, limits: Sequence[AxisLimits]
) -> Callable[[FloatArray], tuple[float, float]]:
    """Return the objective of a motion: the excess of torques over their limits, then -log det M."""
    seen, whole = motions.bases(np.linspace(0.0, motions.period, _INSTANTS, endpoint=False)), motions.whole
    most = np.array([math.inf if one.torque is None else _INSIDE * one.torque for one in limits])

    def score(numbers: FloatArray) -> tuple[float, float]:
        q, v, a = motions.play(numbers, seen, whole)
        columns = model.columns(q, v, a)
        torque = columns @ model.values
        over = float(np.max(np.abs(torque) / most))
        J = (columns / noise[:, np.newaxis]).reshape(-1, columns.shape[2])
        norms = np.linalg.norm(J, axis=0) + 1e-300
        sign, stated = np.linalg.slogdet((J / norms).T @ (J / norms))
        return max(over, 1.0), -float(stated + 2.0 * np.sum(np.log(norms))) if sign > 0 else _NOTHING

    return score


def _search(
    motions: Motions, score: Callable[[FloatArray], tuple[float, float]], seconds: float, seed: int, progress: Progress
) -> tuple[FloatArray, int]:
    """Return the numbers of the best motion, and how many were tried; Ctrl-C ends it with the best so far."""
    rng, began = np.random.default_rng(seed), clock.monotonic()
    pool: list[tuple[tuple[float, float], FloatArray, float]] = []
    tried = 0

    def move(one: tuple[tuple[float, float], FloatArray, float]) -> tuple[tuple[float, float], FloatArray, float]:
        rank, numbers, step = one
        # Some numbers at a time: a motion of one joint is bettered while the others stay.
        which = rng.random(numbers.size) < rng.choice([0.1, 0.3, 1.0])
        other = numbers + step * which * rng.normal(size=numbers.size)
        new = score(other)
        if new < rank:
            return new, other, min(step * _GROWS, 2.0)
        return rank, numbers, max(step * _SHRINKS**0.25, _SMALLEST)

    try:
        for _ in range(_DRAWN):
            numbers = motions.draw(rng)
            pool.append((score(numbers), numbers, _FIRST_STEP))
            tried += 1
        pool = sorted(pool, key=lambda one: one[0])[:_KEPT]
        for place in range(len(pool)):
            for _ in range(_MOVES):
                pool[place] = move(pool[place])
                tried += 1
        best = min(pool, key=lambda one: one[0])
        marked, since = best[0], tried
        while tried < _MOST and tried - since < _STUCK and clock.monotonic() - began < seconds:
            best = move(best)
            tried += 1
            if best[0][0] < marked[0] or best[0][1] < marked[1] - _GAIN:
                marked, since = best[0], tried
            if tried % 500 == 0:
                progress(f"{tried} motions tried, log det of the information {-best[0][1]:.1f}")
    except KeyboardInterrupt:
        if not pool:
            raise
        best = min(pool, key=lambda one: one[0])
    return best[1], tried


def _modes(robot: Robot, q: FloatArray) -> dict[str, float]:
    """Return the frequency of each flexible joint's rotor against its link, the others held, along a motion, Hz.

    Springs are the shafts', so what is held is the other shafts: of coupled motors a link then moves others with it.
    """
    poses, joints = q[:: max(len(q) // 20, 1)], np.linalg.inv(robot.coupling)
    bare = replace(robot, joints=tuple(replace(one, rotor_inertia=0.0, spring=None) for one in robot.joints))
    about = np.mean([np.diag(joints.T @ mass_matrix_at(bare, one) @ joints) for one in poses], axis=0)
    found = {}
    for k, joint in enumerate(robot.joints):
        if joint.spring is not None:
            # Of a link of which nothing is known a twentieth of what swings is the link's.
            link = max(float(about[k]), joint.rotor_inertia / 19.0)
            inertia = joint.rotor_inertia * link / (joint.rotor_inertia + link)
            found[joint.name] = math.sqrt(joint.spring.stiffness / inertia) / (2.0 * math.pi)
    return found


def _multisines(
    robot: Robot, modes: dict[str, float], limits: Sequence[AxisLimits], samples: int, sample_time: float
) -> FloatArray:
    """Return multisines about the mode of each flexible joint, (samples, n), within the range kept for them.

    Sines of equal acceleration; the positions that they take are a part of the margin that motions keep to their ends.
    """
    added = np.zeros((samples, len(limits)))
    for k, joint in enumerate(robot.joints):
        if joint.name not in modes:
            continue
        low, high = (share * modes[joint.name] for share in _ABOUT)
        high = min(high, 0.4 / sample_time)
        wave = excitation.multisine(samples, sample_time, 1.0, min(low, 0.5 * high), high, lines=_LINES, tilt=2.0)
        wave = np.roll(wave, k)  # no two joints alike
        wave[:k] = 0.0
        speed = np.gradient(wave, sample_time)
        limit, most = limits[k], [math.inf]
        assert limit.speed is not None
        assert limit.upper is not None
        assert limit.lower is not None
        most.append(_FOR_MODES * limit.speed / float(np.max(np.abs(speed))))
        most.append(0.01 * (limit.upper - limit.lower))
        if limit.acceleration is not None:
            most.append(_FOR_MODES * limit.acceleration / float(np.max(np.abs(np.gradient(speed, sample_time)))))
        added[:, k] = min(most) * wave
    return added


def _references(robot: Robot, reference: FloatArray, sample_time: float) -> tuple[Record, ...]:
    return tuple(
        Record(
            reference=Channel(
                np.ascontiguousarray(reference[:, k]), robot.position_unit(k), sample_time, source="planned"
            )
        )
        for k in range(len(robot))
    )


def _by_simulation(
    loop: RobotLoop, driven: Sequence[Record], noise: FloatArray, filtering: Filtering | None
) -> tuple[tuple[str, ...], tuple[str, ...], FloatArray, FloatArray]:
    """Return names, units, values and predicted deviations of the parameters by DIDIM.

    Rows that are filtered and thinned hold white noise of the part of its power that passes, so each of them tells as
    much as the samples that it stands for.
    """
    run = require_success(simulate(loop, driven), "The robot's motion")
    parameters = robot_parameters(loop.robot)
    problem = robot_problem(loop, run.records(driven), parameters, filtering)
    numbers = RobotNumbers.of(loop.robot)
    values = parameters.group(numbers)
    kept = run_robot(prepare_robot(loop, driven), numbers, keep=True)
    J = problem.slopes(kept, values)
    assert problem.filtering.decimation is not None
    weights = problem.with_sigma(noise / math.sqrt(problem.filtering.decimation)).weights(len(J))
    units = parameter_units(loop.robot, parameters)
    names = parameters.names
    return names, tuple(units[name] for name in names), values, _deviations(J * weights[:, np.newaxis])


def _sigma(std: float) -> str:
    return number(2 * float(std), 2) if math.isfinite(std) else "not told"
