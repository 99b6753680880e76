"""Learn a controller's law from a record."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.progress import Progress, silent
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.controller_id.fitting import FittedLaw, Task, order_rates
from jointid.controller_id.learned import (
    Alternative,
    Equivalence,
    LearnedLoop,
    LearnedNumber,
    LimitationCode,
)
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.search import Rival, search
from jointid.controller_id.structures import VELOCITY, Structure
from jointid.models.controllers import Controller, numbers_of, shift_start, with_numbers
from jointid.records.record import Record, Tap
from jointid.uncertainty.covariance import Covariance, covariance_of, larger, robust

ALIKE = 10.0  # of the criterion: a smaller difference does not distinguish two laws
SAME = 1e-5  # of the torque's rms: laws that differ by less are one equation
_GAINS = ("kp", "kv", "kd", "time_constant", "frequency")  # the last two of filters
_EXPLAINED = 0.5  # of the torque: what leaves more is no law of this record


def learn_loop(
    record: Record,
    *,
    gain: float = 1.0,
    transmission: Transmission | None = None,
    declared: Controller | None = None,
    progress: Progress = silent,
) -> LearnedLoop:
    """Learn the controller from a record that has its reference, the motor position and the torque.

    The law is applied to the logged reference and position, and its torque compared with the logged one: no joint is
    needed. The numbers are those of maximum likelihood with errors in torque and position (see `noise`), the
    structure that of the least Schwarz criterion (see `search`). From then on torque and reference are enough.

    Args:
        record: with torque, reference and motor_position, the torque's sample time that of the log.
        gain: torque per controller unit, of the drive's chain: gains and limit come out in controller units.
        transmission: of the joint, on whose side the record is; [controller] then says which side that is.
        declared: a controller whose limit and delay are kept where the record does not show them.
        progress: is told each structure that a search goes through.

    Raises:
        RecordError: a channel is missing, too short, or does not move.
        MethodError: the gain is not positive, or no law that is searched for explains half of the torque, or the best
            one's gains are not told.

    Limits of validity: a position loop slower than the log by 2, 4 or 8, or a whole loop faster by 2 to 16; a delay of
    the log of whole samples. An integral, a feed-forward or a delay that carries less than 0.1 % of the torque is taken
    for none. What the record leaves open is in `LearnedLoop.limitations`.

    Example:
        >>> import jointid as ji, numpy as np
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=60.0, kv=500.0))
        >>> reference = ji.trapezoids([0.1, 0.3], 2.0, 0.2, 1e-3, 0.1, 8.0)
        >>> values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 0.0}
        >>> noise = 0.02 * np.random.default_rng(0).standard_normal(reference.size)
        >>> record = ji.simulated_record(
        ...     loop, reference, values, sample_time=1e-3, torque_noise=noise, encoder_step=1e-7
        ... )
        >>> print(ji.learn_loop(record).structure)
        P-P
    """
    if not (math.isfinite(gain) and gain > 0):
        raise MethodError(f"The gain of a drive's chain is a positive number; received {gain}.")
    task = Task(prepare_loop_record(record), gain)
    best, rivals = search(task, progress)
    _require_explained(task, best, record.name)
    return _build_result(task, order_rates(task, best), rivals, transmission, declared)


def _require_explained(task: Task, best: FittedLaw, name: str) -> None:
    """Raise a `MethodError` if the best law does not explain the torque."""
    residual, torque = task.residual(best.structure, best.numbers), task.log.torque
    share = float(np.sqrt(np.mean(residual**2) / np.mean(torque**2)))
    blind = task.law(best.structure, best.numbers).stiffness == 0.0
    if blind or share > _EXPLAINED or not np.any(best.noise.informative[1:]):
        answers = ", does not look at the position and" if blind else ","
        raise MethodError(
            f"No law that is searched for gives the torque of {name}: the best, {best.structure}{answers} leaves "
            f"{100 * share:.3g} % of it. Check units, signs and sides of torque, reference and motor_position, and log "
            "them as fast as the controller runs; or declare the law."
        )


def _require_significant(task: Task, best: FittedLaw, known: Covariance) -> None:
    """Raise a `MethodError` if a gain or a filter constant is not significantly different from 0."""
    open_ones = [
        f"{name} {value:.3g} +- {2 * std:.2g}"
        for (name, value), std in zip(best.numbers.items(), known.std, strict=True)
        if name.rpartition(".")[2] in _GAINS and not 2 * std < value
    ]
    if open_ones:
        raise MethodError(
            f"No law that is searched for gives the torque of {task.log.record.name}: the best, "
            f"{best.structure}, leaves open what its numbers are ({', '.join(open_ones)} at 2 sigma). Use a "
            "record with a livelier motion, check units, signs and sides of its channels, or declare the law."
        )


def _keep_declared(made: Controller, declared: Controller | None) -> tuple[Controller, tuple[Message, ...]]:
    """Return a law with the declared limit and delay where the record does not show them, and that limitation."""
    said = {} if declared is None else numbers_of(declared)
    open_ones = {"limit": math.inf, "delay": 0.0}
    own = numbers_of(made)
    kept = {n: said[n] for n, free in open_ones.items() if n in said and own.get(n) == free != said[n]}
    if not kept:
        return made, ()
    listed = " and ".join(f"{name} = {value:g}" for name, value in kept.items())
    words = f"As declared, and not from this record: {listed}."
    return with_numbers(made, kept), (Message(LimitationCode.AS_DECLARED, words, {"numbers": kept}),)


def _build_result(
    task: Task,
    best: FittedLaw,
    rivals: tuple[Rival, ...],
    transmission: Transmission | None,
    declared: Controller | None,
) -> LearnedLoop:
    record, period = task.log.record, task.log.period
    assert record.torque is not None and record.motor_position is not None
    known = covariance(task, best)
    _require_significant(task, best, known)
    made, declared_ones = _keep_declared(_build_controller(task, best), declared)
    residual = task.residual(best.structure, best.numbers)
    rms = float(np.sqrt(np.sum(residual**2) / np.sum(task.log.kept)))
    others = tuple(
        Alternative(
            rival.fitted.structure, _build_controller(task, rival.fitted), rival.worse, rival.apart,
            alike=rival.worse < ALIKE or rival.apart < SAME,
        )
        for rival in rivals
    )  # fmt: skip
    named = tuple(other.structure for other in others if other.apart < SAME)
    alike = tuple(o.structure for o in others if o.alike and o.apart >= SAME)
    informative = np.flatnonzero(best.noise.informative)
    return LearnedLoop(
        controller=made,
        structure=best.structure,
        numbers=tuple(
            LearnedNumber(name, value, float(std))
            for (name, value), std in zip(best.numbers.items(), known.std, strict=True)
        ),
        correlation=known.correlation,
        equivalent=(*list_equivalents(best.structure), *named),
        alternatives=others,
        limitations=(*list_limitations(task, best, alike), *declared_ones),
        rms=rms,
        share=rms / float(np.sqrt(np.mean(task.log.torque**2))),
        torque_noise=math.sqrt(best.noise.torque),
        position_noise=math.sqrt(best.noise.position),
        band=float(informative[-1]) / (task.log.samples * period) if informative.size else 0.0,
        residual=residual,
        torque_unit=record.torque.unit,
        position_unit=record.motor_position.unit,
        record=record.name,
        transmission=transmission,
        resampled=record.resampled,
    )


def list_equivalents(structure: Structure) -> Iterator[Message]:
    """Yield the other forms of a law: the same equation, its gains in terms of those that were found."""
    code, velocity = Equivalence, structure.reference_velocity
    plain = structure.velocity_filter == "none" and structure.every == 1
    if structure.law == "P-P" and velocity == "none" and structure.every == 1:
        yield Message(code.PD, 'PD with reference_velocity = "none", its kp = kp kv and kd = kv')
    if structure.law == "P-P" and velocity == "full" and plain:
        yield Message(code.PD_ON_DIFFERENCE, 'PD with reference_velocity = "difference", its kp = kp kv and kd = kv')
    if structure.law == "P-P" and velocity == "share":
        yield Message(code.VISCOUS_FEEDFORWARD, "P-P with viscous_feedforward = kv velocity_feedforward instead")
    if structure.law == "P-PI" and velocity == "full" and plain:
        yield Message(
            code.PID_ON_DIFFERENCE,
            'PID with reference_velocity = "difference", its kp = kv (kp + ki), kd = kv (1 - ki T), ki = kv kp ki',
        )
    if not structure.cascade and VELOCITY in structure.feedforward and velocity == "difference":
        yield Message(code.REFERENCE_VELOCITY_WEIGHT, "the same with a larger weight of the reference's velocity")


def list_limitations(task: Task, best: FittedLaw, alike: tuple[Structure, ...]) -> Iterator[Message]:
    """Yield what a record leaves open about a law; `alike` are the structures that it does not distinguish from it."""
    structure, log, code = best.structure, task.log, LimitationCode
    if not structure.integrates:
        yield Message(
            code.NO_INTEGRAL,
            "No integral action is visible in this record: it contributes less than 0.1 % of the torque, or there is "
            "none.",
        )
    if not structure.limited:
        assert log.record.torque is not None
        largest, unit = float(abs(log.torque).max()), log.record.torque.unit
        yield Message(
            code.LIMIT_NOT_REACHED,
            f"The limit is not reached in this record; it is above {number(largest, 4)} {unit}, the largest torque.",
            {"torque": largest, "unit": unit},
        )
    elif structure.integrates:
        yield Message(
            code.ANTI_WINDUP_NOT_TESTED,
            "The behaviour of the integral at the limit (anti_windup) was not tested; it is assumed to stop.",
        )
    if structure.torque_filter == "none":
        yield Message(code.TORQUE_FILTER_HIDDEN, "A torque filter whose effect is below the noise cannot be detected.")
    if log.record.tap is Tap.COMMAND:
        yield Message(
            code.DELAY_NOT_VISIBLE,
            'A delay between the controller\'s output and the acting torque is not visible at the tap "command"; take '
            "delay from the drive's documentation.",
        )
        if structure.late:
            yield Message(
                code.TORQUE_LOGGED_LATE,
                f"The log shows the torque {structure.late} samples later than the position it depends on; declare "
                'tap = "measured" for the torque, so that the delay is visible in it, or shift the log.',
                {"samples": structure.late},
            )
    if structure.rate > 1 or any(other.rate != structure.rate for other in alike):
        yield Message(
            code.PERIOD_UNCERTAIN,
            "The loop's period follows only from the lag of its velocity; a velocity filter may have the same effect.",
        )
        yield Message(
            code.INTERPOLATION_ASSUMED,
            "Between the log's samples the reference is assumed to follow the controller's interpolation, and the "
            "position a cubic spline. Where that is wrong, the errors are larger than the intervals.",
        )
    if alike:
        said = f"This record does not distinguish this law from: {'; '.join(map(str, alike))}."
        yield Message(code.INDISTINGUISHABLE, said, {"structures": alike})


def _build_controller(task: Task, one: FittedLaw) -> Controller:
    """Return a law that counts from the first sample of the record's file, as controllers do."""
    return shift_start(task.controller(one.structure, one.numbers), -task.log.record.begin)


def covariance(task: Task, best: FittedLaw) -> Covariance:
    """Return the covariance of a law's numbers, robust against what colour and what uneven size remain."""
    noise = task.noise(best.structure, best.numbers)
    x = np.array(list(best.numbers.values()))
    white = task.whiten(best.structure, best.numbers, noise)
    J = -task.slopes(best.structure, x, white, noise)
    return larger(robust(J, J, white), covariance_by_frequency(J, white))


def covariance_by_frequency(J: FloatArray, white: FloatArray) -> Covariance:
    """Return the covariance from the scores of each frequency alone: J (samples, numbers), the rest (samples,) white.

    An encoder's rounding stands still where the motor does, so that it is loudest where the motion is slow, as the
    motion itself is: a spectrum that is smoothed, or a few neighbouring rows, would miss that. Heteroscedasticity
    over frequencies needs neither (White 1980, of the real transform).
    """
    norms = column_norms(J)
    products = np.fft.rfft(J / norms, axis=0).conj() * np.fft.rfft(white)[:, np.newaxis]
    scores = 2.0 / white.size * np.real(products)
    spread = np.linalg.pinv((J / norms).T @ (J / norms))
    found = covariance_of(spread @ (scores.T @ scores) @ spread.T, 0)
    return Covariance(found.std / norms, found.correlation, 0)
