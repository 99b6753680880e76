"""Other laws of a drive as causes of a gross misfit: its rate, and what it does with its reference; see `variants`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from jointid.common.errors import JointidError
from jointid.diagnostics.faults.fault import Hypothesis, Meaning
from jointid.diagnostics.faults.numbers import REFERENCE_DELAY
from jointid.diagnostics.hypothesis_fits import Fit
from jointid.diagnostics.variants import (
    AVERAGED,
    INTERPOLATIONS,
    MEASURED_VELOCITY,
    PERIOD,
    PRESENT_SAMPLE,
    TIMES_FASTER,
    average_reference,
    list_other_ways,
    say_mean,
    say_way,
)
from jointid.estimation.descent import descend
from jointid.models.controllers.servo_base import DiagramController, Interpolation

_NEARLY = 0.5  # periods: a reference that is later is late


def _try_periods(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if isinstance(law, DiagramController) and law.period is None:
        faster = declared.under([replace(law, period=declared.period / times) for times in TIMES_FASTER])
        yield replace(faster, number=lambda problem: problem.axis.law.period)


def _try_interpolation(way: Interpolation, declared: Hypothesis) -> Iterator[Hypothesis]:
    """Yield the drive with another interpolation, at faster rates without a declared period."""
    law = declared.controller
    if way in list_other_ways(law, declared.record, declared.period):
        yield declared.under([replace(law, interpolation=way)])
    elif way == "hold":
        for faster in _try_periods(declared):
            laws = [replace(law, interpolation=way, period=declared.period / times) for times in TIMES_FASTER]
            if way in list_other_ways(faster.controller, declared.record, faster.controller.period):
                yield replace(declared.under(laws), number=faster.number)


def _judge_mean(declared: Hypothesis, best: Fit | None, _: float) -> tuple[float | None, float] | None:
    """Return the averaging time that fits best, and its residual."""
    if (
        best is None
        or best.hypothesis.fault is not REFERENCE_DELAY
        or not hasattr(declared.controller, "velocity_filter")
    ):
        return None
    late = (best.number or 0.0) - declared.controller.reference_delay
    if late < _NEARLY * declared.period:
        return None
    own = tuple(p for p in best.problem.parameters if p.name != REFERENCE_DELAY.name)
    problem = replace(best.problem, loop=replace(best.problem.loop, controller=declared.controller), parameters=own)
    try:
        law = average_reference(declared.controller, best.number or 0.0, declared.period).controller
        averaged = problem.under(law, declared.record)
        x = descend(averaged, problem.vector(best.values), 1e-6).x
        return getattr(law, "reference_average", None), averaged.filtered_error(averaged.residual(x))
    except (JointidError, np.linalg.LinAlgError):
        return None


def _explain_interpolation(way: Interpolation, period: float | None, *_: object) -> Iterator[Meaning]:
    said = f'{say_way(way)}: declare interpolation = "{way}"'
    more = "" if period is None else f", and the controller's period, about {1e3 * period:.4g} ms"
    yield INTERPOLATIONS[way], said + more, period


def _explain_mean(mean: float | None, *_: object) -> Iterator[Meaning]:
    yield AVERAGED, f"{say_mean(mean or 0.0)}: declare reference_average = {mean or 0.0:.6g}", mean


FAULTS = (
    PRESENT_SAMPLE,
    MEASURED_VELOCITY,
    replace(
        PERIOD, correct=_try_periods,
        clause="the controller runs faster than the log: declare its period, about {fine} ms, and its interpolation",
    ),
    *(
        replace(fault, correct=partial(_try_interpolation, way), meanings=partial(_explain_interpolation, way))
        for way, fault in INTERPOLATIONS.items()
    ),
    replace(AVERAGED, judge=_judge_mean, meanings=_explain_mean),
)  # fmt: skip
