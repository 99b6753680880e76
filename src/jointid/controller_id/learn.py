"""Learn a controller from a record: law, numbers with intervals, alternatives, limitations."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.transmission import Transmission
from jointid.controller_id.fitting import FittedLaw, Task, covariance, order_rates
from jointid.controller_id.learned_controller import Alternative, LearnedController, LearnedNumber
from jointid.controller_id.limitations import INTERRUPTED, fill_from_declaration, list_limitations
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.ranking import ALIKE, Rival
from jointid.controller_id.regression import compare_with_regression
from jointid.controller_id.search import search
from jointid.controller_id.structures import INTEGRAL, Structure
from jointid.diagnostics.faults.forces import find_steps
from jointid.models.controllers import Controller, shift_start, unit_of_number
from jointid.records.record import Record
from jointid.uncertainty.covariance import Covariance

SAME = 1e-5  # of the torque's rms: laws that differ by less are one equation
_GAINS = ("position_gain", "velocity_gain", "derivative_gain", "time_constant", "frequency")  # the last two of filters
_EXPLAINED = 0.5  # of the torque: what leaves more is no law of this record
_LEFT, _LASTING = 0.05, 10  # of the torque, averaged over so many samples: noise leaves less, a wrong law more


@one_thread()
def learn_controller(
    record: Record,
    *,
    gain: float = 1.0,
    transmission: Transmission | None = None,
    declared: Controller | None = None,
    progress: Progress = ignore_progress,
) -> LearnedController:
    """Learn the controller from a record that has its reference, the motor position and the torque.

    The law is applied to the logged reference and position, and its torque compared with the logged one: no joint is
    needed. The numbers are those of maximum likelihood with errors in torque and position (see `noise`), the
    structure that of the least Schwarz criterion (see `search`). From then on torque and reference are enough.

    Args:
        record: with torque, reference and motor_position, the torque's sample time that of the log.
        gain: torque per controller unit, of the drive's chain: gains and limit come out in controller units.
        transmission: of the joint, on whose side the record is; [controller] then says which side that is.
        declared: a controller whose limit and delay are kept where the record does not show them.
        progress: receives messages.

    Raises:
        RecordError: a channel is missing, too short, or does not move.
        MethodError: the gain is not positive, or every law that is searched for leaves half of the torque, or more than
            5 % of it averaged over 10 samples, which no noise does, or the best one's gains are not significant.

    Limits of validity: a position loop slower than the log by 2, 4 or 8, or a whole loop faster by 2 to 16; a delay of
    the log of whole samples. An integral, a feed-forward or a delay that carries less than 0.1 % of the torque is taken
    for none. What the record leaves open is in `LearnedController.limitations`.

    Example:
        >>> import jointid as ji, numpy as np
        >>> law = ji.controller.Cascade(position_gain=60.0, velocity_gain=500.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> reference = ji.excitation.trapezoids([0.1, 0.3], 2.0, 0.2, 1e-3, 0.1, 2.0)
        >>> values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 0.0}
        >>> noise = 0.02 * np.random.default_rng(0).standard_normal(reference.size)
        >>> record = ji.simulated_record(
        ...     loop, reference, values, sample_time=1e-3, torque_noise=noise, encoder_step=1e-7
        ... )
        >>> print(ji.learn_controller(record).structure)
        P-P
    """
    if not isinstance(record, Record):
        raise MethodError(
            f"A controller is learned from one record of one joint; received {type(record).__name__}: of a robot give "
            "that of a joint, or take one joint of its file by axis or --axis."
        )
    if not (math.isfinite(gain) and gain > 0):
        raise MethodError(f"The gain of a drive's chain is a positive number; received {gain}.")
    task = Task(prepare_loop_record(record), gain)
    best, rivals, ended = search(task, progress)
    _check_residual(task, best, _LEFT if ended else _EXPLAINED)
    return _build_result(task, order_rates(task, best), rivals, ended, transmission, declared)


def _check_residual(task: Task, best: FittedLaw, most: float) -> None:
    """Refuse a law that leaves more than `most` of the averaged torque, or ignores the position."""
    residual, torque = task.residual(best.structure, best.numbers), task.log.torque
    lasting = np.convolve(residual, np.full(_LASTING, 1.0 / _LASTING), "same")
    share, lasts = (float(np.sqrt(np.mean(one**2) / np.mean(torque**2))) for one in (residual, lasting))
    blind = task.law(best.structure, best.numbers).stiffness == 0.0
    if not (blind or share > _EXPLAINED or lasts > most or not np.any(best.noise.informative[1:])):
        return
    answers = ", does not look at the position and" if blind else ","
    steps = None if blind else find_steps(task.log.record)
    remedy = (
        "Check units, signs and sides of torque, reference and motor_position, and that all are of one clock; log them "
        "as fast as the controller runs; give what is injected as the channel injected; or declare the law."
        if steps is None
        else f"{steps.brief[:1].upper()}{steps.brief[1:]}: add that channel, or log again without it."
    )
    raise MethodError(
        f"No law that is searched for gives the torque of {task.log.record.name}: the best, {best.structure}{answers} "
        f"leaves {100 * share:.3g} % of it, {100 * lasts:.3g} % averaged over {_LASTING} samples (at most "
        f"{100 * most:g} % expected of noise). {remedy}"
    )


def _require_significant(task: Task, best: FittedLaw, known: Covariance) -> None:
    open_ones = [
        f"{name} {value:.3g} ± {2 * std:.2g}"
        for (name, value), std in zip(best.numbers.items(), known.std, strict=True)
        if name.rpartition(".")[2] in _GAINS and not 2 * std < value
    ]
    if not open_ones:
        return
    remedy = (
        "Log as fast as the controller runs, use a record with more reversals and speeds, check units, signs and sides "
        "of its channels, or declare the law."
        if task.log.record.injected is None
        # A law faster than the log reacts to it before the log shows what it saw.
        else "A controller that is faster than the log answers the injected signal between its samples: log as fast as "
        "the controller runs, use a record without that signal, or declare the law with its period."
    )
    raise MethodError(
        f"No law that is searched for gives the torque of {task.log.record.name}: the best, {best.structure}, leaves "
        f"open what its numbers are ({', '.join(open_ones)} at 2 sigma). {remedy}"
    )


def _build_result(
    task: Task,
    best: FittedLaw,
    rivals: tuple[Rival, ...],
    ended: bool,
    transmission: Transmission | None,
    declared: Controller | None,
) -> LearnedController:
    record, period = task.log.record, task.log.period
    assert record.torque is not None and record.motor_position is not None
    known = covariance(task, best)
    _require_significant(task, best, known)
    made, declared_ones = fill_from_declaration(_build_controller(task, best), declared)
    residual = task.residual(best.structure, best.numbers)
    rms = float(np.sqrt(np.sum(residual**2) / np.sum(task.log.kept)))
    others = tuple(
        Alternative(
            rival.fitted.structure, _build_controller(task, rival.fitted), rival.worse, rival.apart,
            alike=rival.worse < ALIKE or rival.apart < SAME,
        )
        for rival in rivals
    )  # fmt: skip
    alike = tuple(o.structure for o in others if o.alike and o.apart >= SAME)
    like_it = (rival.fitted for rival, other in zip(rivals, others, strict=True) if other.alike)
    informative, beside = np.flatnonzero(best.noise.informative), compare_with_regression(task.log, residual)
    return LearnedController(
        controller=made,
        structure=best.structure,
        numbers=_numbers_with_intervals(task, best, known, like_it),
        correlation=known.correlation,
        alternatives=others,
        limitations=(
            *list_limitations(task.log, best.structure, alike, beside),
            *declared_ones,
            *([] if ended else [INTERRUPTED]),
        ),
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
        regression_share=beside.regression,
    )


def _build_controller(task: Task, one: FittedLaw) -> Controller:
    """Build the controller with the phase of the record's first sample."""
    return shift_start(task.controller(one.structure, one.numbers), -task.log.record.begin)


def _numbers_with_intervals(
    task: Task, best: FittedLaw, known: Covariance, alike: Iterable[FittedLaw]
) -> tuple[LearnedNumber, ...]:
    """Numbers of a law, with intervals over all indistinguishable laws that share the number.

    Cascades share numbers, as do PD and PID laws; filters of the same kind share theirs.
    """
    made = task.controller(best.structure, best.numbers)
    spans = {name: [ends] for name, ends in _intervals(best, known)}
    for other in (order_rates(task, one) for one in alike):
        if other.structure.cascade != best.structure.cascade:
            continue
        for name, ends in _intervals(other, covariance(task, other)):
            if name in spans and _is_same_part(name, best.structure, other.structure) and math.isfinite(ends[0]):
                spans[name].append(ends)
    hulls = [(min(low for low, _ in ends), max(high for _, high in ends)) for ends in spans.values()]
    return tuple(
        LearnedNumber(name, value, float(std), _unit_of(made, name, task.log.record), *hull)
        for (name, value), std, hull in zip(best.numbers.items(), known.std, hulls, strict=True)
    )


def _intervals(one: FittedLaw, known: Covariance) -> Iterator[tuple[str, tuple[float, float]]]:
    for (name, value), std in zip(one.numbers.items(), map(float, known.std), strict=True):
        yield name, (value - 2 * std, value + 2 * std)


def _is_same_part(name: str, one: Structure, other: Structure) -> bool:
    """Test whether a number belongs to the same kind of filter, or none."""
    if name.startswith("velocity_filter"):
        return one.velocity_filter == other.velocity_filter
    return not name.startswith("torque_filters") or one.torque_filter == other.torque_filter


def _unit_of(made: Controller, name: str, record: Record) -> str:
    assert record.torque is not None and record.motor_position is not None
    named = "constant_feedforward" if name == INTEGRAL else name  # both are held in the controller's output
    return unit_of_number(made, named, record.motor_position.unit, record.torque.unit)
