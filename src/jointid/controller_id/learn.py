"""Learn a controller from a record: law, numbers with intervals, alternatives, limitations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Table, Text, common_facts
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.text import in_words, join, number, sentence
from jointid.common.transmission import Transmission
from jointid.common.units import per
from jointid.controller_id.fitting import FittedLaw, Fitter
from jointid.controller_id.loop_record import LoopRecord, prepare_loop_record
from jointid.controller_id.search import ALIKE, Rival, search
from jointid.controller_id.structures import INTEGRAL, Structure, controller, per_controller_unit
from jointid.models.controllers import (
    CONTROLLER_UNITS,
    Controller,
    numbers_of,
    shift_start,
    unit_of_number,
    with_numbers,
)
from jointid.records.record import Record, Resampled, takes_record
from jointid.uncertainty.covariance import Covariance

SAME = 1e-5  # of the torque's rms: laws that differ by less are one equation
_GAINS = ("position_gain", "velocity_gain", "derivative_gain", "time_constant", "frequency")  # the last two of filters
_EXPLAINED = 0.5  # of the torque: what leaves more is no law of this record
_LEFT, _LASTING = 0.05, 10  # of the torque, averaged over so many samples: noise leaves less, a wrong law more
_CUT = 0.8  # of the cost without: a limit that leaves more was a torque that only lingered
_MUCH = 3.0  # times what no law explains, in rms: an F of 9, of hundreds of rows
_MATERIAL = 2e-3  # of the torque's rms: a law that leaves less is good enough for whatever it is needed for
_TUNED = ("_gain", "derivative_time")  # what the names of gains and their times end with


@dataclass(frozen=True, slots=True)
class LearnedNumber:
    """One number of the law.

    Attributes:
        name: as in `jointid.models.controllers.numbers_of`; "integral" is the state of an integral at the first
            sample, in controller units.
        value: in the law's units.
        std: standard deviation, if this law is the drive's.
        unit: of the value; "" for a number without.
        lower, upper: ends of the interval: 2 deviations either way, over this law and all indistinguishable laws with
            the same number.
    """

    name: str
    value: float
    std: float
    unit: str = ""
    lower: float = math.nan
    upper: float = math.nan

    @property
    def spread(self) -> float:
        """Distance from the value to the further end of its interval."""
        return max(self.upper - self.value, self.value - self.lower)


@dataclass(frozen=True, slots=True, eq=False)
class LearnedController(Documented):
    """A controller, learned from a record.

    Attributes:
        controller: the law with its numbers.
        structure: of the law; its text is the description.
        numbers: learned from the record.
        correlation: of their errors, in that order.
        alternatives: structures that the record does not distinguish from it, the likeliest first.
        regression: residual share of a linear regression, if it is small enough to exclude the law; else None.
        kept: numbers taken from the declaration, not from this record.
        rms: of the residual, in the torque's unit. share: of the torque's rms.
        torque_noise: standard deviation of the torque's error, in its unit. position_noise: of the position's.
        residual: (samples,) logged less predicted torque, 0 in the samples that are left out.
        torque_unit, position_unit: of the record.
        record: its name.
        transmission: between the motor and the units of the law; None without one.
        resampled: resampling of the record to a uniform clock; None if it was logged so.
    """

    controller: Controller
    structure: Structure
    numbers: tuple[LearnedNumber, ...]
    correlation: FloatArray
    alternatives: tuple[Rival, ...]
    regression: float | None
    kept: Mapping[str, float]
    rms: float
    share: float
    torque_noise: float
    position_noise: float
    residual: FloatArray
    torque_unit: str
    position_unit: str
    record: str
    transmission: Transmission | None
    resampled: Resampled | None = None

    def __getitem__(self, name: str) -> LearnedNumber:
        """Return a number by its name."""
        for one in self.numbers:
            if one.name == name:
                return one
        raise KeyError(name)

    @property
    def sentence(self) -> str:
        """The law, and how well it gives the torque."""
        if self.regression is not None:
            return (
                f"The best law of the search, {self.structure}, leaves {100 * self.share:.2g} % of the torque, a "
                f"plain regression {100 * self.regression:.2g} %: the drive's law is another; declare it."
            )
        gains = [
            f"{in_words(one.name)} {number(one.value, 4)} {one.unit}".rstrip()
            for one in self._in_si()
            if one.name.endswith(_TUNED)
        ]
        found = f"the controller is {self.structure}, and leaves {100 * self.share:.2g} % of the torque."
        return sentence(f"{join(gains)}: {found}" if gains else found)

    def _in_si(self) -> tuple[LearnedNumber, ...]:
        """Return the numbers in SI."""
        gain: float = getattr(self.controller, "gain", 1.0)
        found = list[LearnedNumber]()
        for n in self.numbers:
            scaled = CONTROLLER_UNITS in n.unit
            by, unit = (gain, _in_torque(n.unit, self.torque_unit)) if scaled else (1.0, n.unit)
            found.append(LearnedNumber(n.name, by * n.value, by * n.std, unit, by * n.lower, by * n.upper))
        return tuple(found)

    def to_document(self, *, details: bool = False) -> Document:
        """Numbers, other structures, and what was kept."""
        del details
        explanation = "± is 2 deviations, over all laws that the record does not distinguish"
        if (gain := getattr(self.controller, "gain", 1.0)) != 1.0:
            explanation += f"; the gain of the output is {number(gain)} {self.torque_unit}"
        rows = list[tuple[str, ...]]()
        for n in self._in_si():
            percent = number(100 * n.spread / abs(n.value), 2) if n.value else "-"
            rows.append((n.name, number(n.value, 6), number(n.spread, 2), n.unit, percent))
        others = [f"{one.structure}: {100 * one.apart:.2g} %" for one in self.alternatives]
        facts = [
            ("residual", f"{number(self.rms, 3)} {self.torque_unit} rms"),
            ("noise of the torque", f"{number(self.torque_noise, 2)} {self.torque_unit}"),
            ("noise of the position", f"{number(self.position_noise, 2)} {self.position_unit}"),
            *[("as declared, and not from this record", f"{name} = {value:g}") for name, value in self.kept.items()],
        ]
        blocks: list[Block] = [
            Facts((("record", self.record), *common_facts(self.resampled, None))),
            Table(("parameter in SI", "value", "±", "unit", "%"), tuple(rows), words=(0, 3)),
            Text(explanation),
            Facts(tuple(facts)),
        ]
        if others:
            said = "Laws that the record does not distinguish from it, and by how much their torque differs:"
            blocks += [Text(said), Text("\n".join(others), "list")]
        return Document(self.sentence, tuple(blocks))


def _in_torque(unit: str, torque_unit: str) -> str:
    """Multiply a unit of `unit_of_number` by the controller's gain: "N s/m"."""
    above, stroke, below = unit.replace(CONTROLLER_UNITS, torque_unit).partition(" per ")
    return per(above, below) if stroke else above


@one_thread
@takes_record
def learn_controller(
    record: Record,
    *,
    gain: float = 1.0,
    transmission: Transmission | None = None,
    declared: Controller | None = None,
    progress: Progress = ignore_progress,
) -> LearnedController:
    """Learn the controller from a record of reference, motor position and torque.

    The law is applied to the logged reference and position, and its torque compared with the logged one: no joint is
    needed. The numbers are those of maximum likelihood with errors in torque and position (see `noise`), the
    structure that of the least Schwarz criterion (see `search`). From then on torque and reference are enough.

    Args:
        record: with torque, reference and motor_position, the torque's sample time that of the log.
        gain: torque per controller unit of the drive's chain. Gains and limit are in controller units.
        transmission: of the joint, on whose side the record is; [controller] then states the side.
        declared: a controller whose limit and delay are kept if the record does not show them.
        progress: receives messages.

    Raises:
        RecordError: a channel is missing, too short, or does not move.
        MethodError: the gain is not positive, or the residual of every law is half of the torque, or more than 5 % of
            it averaged over 10 samples, which is no noise, or the best one's gains are not significant.

    Limits of validity: a position loop slower than the log by 2, 4 or 8, or a whole loop faster by 2 to 16; a delay of
    the log of whole samples. An integral, a feed-forward or a delay with less than 0.1 % of the torque is
    neglected. `LearnedController.kept` has the numbers kept from a declaration.

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
    if not (math.isfinite(gain) and gain > 0):
        raise MethodError(f"The gain of a drive's chain is a positive number; received {gain}.")
    log = prepare_loop_record(record)
    assert record.torque is not None and record.motor_position is not None
    torque_unit, position_unit = record.torque.unit, record.motor_position.unit
    fitter, likeliest, rivals = search(log, progress)
    best, known = fitter.finish(likeliest)
    limit = _find_limit(fitter, best)
    residual = (log.torque - np.clip(fitter.predict(best), -limit, limit)) * log.kept
    _require_explained(log, best, known, residual)
    limits = {} if math.isinf(limit) else {"limit": limit}

    def build(one: FittedLaw) -> Controller:
        """Build the controller with the phase of the record's first sample."""
        numbers = per_controller_unit(one.structure, one.numbers | limits, gain)
        return shift_start(controller(one.structure, numbers, log.period, gain), -record.begin)

    alike = [one for one in rivals if one.worse < ALIKE or one.apart < SAME]
    spans = _span(best, [(best, known), *(fitter.finish(one.fitted) for one in alike)])
    if limits:
        known = known.append_constants(1)
        known.std[-1] = deviation = math.sqrt(best.noise.torque / max(float(np.sum(log.kept - log.free)), 1.0))
        best.numbers.update(limits)
        spans["limit"] = limit - 2 * deviation, limit + 2 * deviation
    made, kept = fill_from_declaration(build(best), declared)
    by, units = per_controller_unit(best.structure, dict.fromkeys(best.numbers, 1.0), gain), []
    for name in best.numbers:
        held = name if name != INTEGRAL else "constant_feedforward"  # both are held in the controller's output
        units.append(unit_of_number(made, held, position_unit, torque_unit))
    rms = float(np.sqrt(np.sum(residual**2) / np.sum(log.kept)))
    return LearnedController(
        controller=made,
        structure=best.structure,
        numbers=tuple(
            LearnedNumber(name, by[name] * value, by[name] * float(std), unit, *(by[name] * end for end in spans[name]))
            for (name, value), std, unit in zip(best.numbers.items(), known.std, units, strict=True)
        ),
        correlation=known.correlation,
        alternatives=tuple(alike),
        regression=_find_better_regression(log, residual),
        kept=kept,
        rms=rms,
        share=rms / float(np.sqrt(np.mean(log.torque**2))),
        torque_noise=math.sqrt(best.noise.torque),
        position_noise=math.sqrt(best.noise.position),
        residual=residual,
        torque_unit=torque_unit,
        position_unit=position_unit,
        record=record.name,
        transmission=transmission,
        resampled=record.resampled,
    )


def fill_from_declaration(made: Controller, declared: Controller | None) -> tuple[Controller, dict[str, float]]:
    """Complete a learned limit and delay from the declaration; return those taken."""
    said = {} if declared is None else numbers_of(declared)
    if "limit" in said:  # in the units of the law that was learned, which is on the joint's side
        there, here = (getattr(one, "gain", 1.0) * getattr(one, "ratio", 1.0) for one in (declared, made))
        said["limit"] *= abs(there / here)
    open_ones, own = {"limit": math.inf, "delay": 0.0}, numbers_of(made)
    kept = {n: said[n] for n, free in open_ones.items() if n in said and own.get(n) == free != said[n]}
    return with_numbers(made, kept) if kept else made, kept


def _find_limit(fitter: Fitter, best: FittedLaw) -> float:
    """Torque limit: the log's plateau if the law exceeds it; else infinite."""
    log, shown = fitter.log, fitter.predict(best)
    if log.plateau is None:
        return math.inf
    left, cut = (
        ((log.torque - one) * (log.kept - log.free)) for one in (shown, np.clip(shown, -log.plateau, log.plateau))
    )
    return log.plateau if float(cut @ cut) <= _CUT * float(left @ left) else math.inf


def _require_explained(log: LoopRecord, best: FittedLaw, known: Covariance, residual: FloatArray) -> None:
    """Refuse a law with large residual, insignificant gains or no informative frequencies."""
    lasting = np.convolve(residual, np.full(_LASTING, 1.0 / _LASTING), "same")
    share, lasts = (float(np.sqrt(np.mean(one**2) / np.mean(log.torque**2))) for one in (residual, lasting))
    poor = share > _EXPLAINED or lasts > _LEFT or not np.any(log.informative[1:])
    open_ones = [
        f"{name} {value:.3g} ± {2 * std:.2g}"
        for (name, value), std in zip(best.numbers.items(), known.std, strict=True)
        if name.rpartition(".")[2] in _GAINS and not 2 * std < value
    ]
    if poor or open_ones:
        fact = f"leaves {100 * share:.3g} % of it, {100 * lasts:.3g} % averaged over {_LASTING} samples"
        fact = fact if poor else f"leaves open what its numbers are ({', '.join(open_ones)} at 2 sigma)"
        raise MethodError(
            f"No law that is searched for gives the torque of {log.record.name}: the best, {best.structure}, {fact}. "
            "Check units, signs and sides of torque, reference and motor_position, and that all are of one clock; log "
            "them as fast as the controller runs, with more reversals and speeds, and with what is injected; or state "
            "the law."
        )


def _find_better_regression(log: LoopRecord, residual: FloatArray) -> float | None:
    """Residual share of a regression that excludes the law; otherwise None."""
    both = np.fft.rfft(np.column_stack([residual, log.unexplained]) * log.free[:, np.newaxis], axis=0)
    heard = np.fft.irfft(both * (log.informative > 0)[:, np.newaxis], log.samples, axis=0)
    law, regression = np.sqrt(np.mean(heard**2, axis=0) / np.mean((log.torque * log.free) ** 2))
    return float(regression) if law > max(_MUCH * regression, _MATERIAL) else None


def _span(best: FittedLaw, alike: Sequence[tuple[FittedLaw, Covariance]]) -> dict[str, tuple[float, float]]:
    """Intervals of a law's numbers over all indistinguishable laws with that number.

    Cascades share numbers, as do PD and PID laws; filters of the same kind share theirs.
    """

    def part(one: Structure, name: str) -> tuple[object, ...]:
        kinds = {"velocity_filter": one.velocity_filter, "torque_filters": one.torque_filter}
        return one.cascade, kinds.get(name.partition(".")[0]), name

    spans = {part(best.structure, name): (math.inf, -math.inf) for name in best.numbers}
    for one, known in alike:
        for (name, value), std in zip(one.numbers.items(), map(float, known.std), strict=True):
            if (key := part(one.structure, name)) in spans and math.isfinite(std):
                spans[key] = min(spans[key][0], value - 2 * std), max(spans[key][1], value + 2 * std)
    return dict(zip(best.numbers, spans.values(), strict=True))
