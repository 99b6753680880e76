"""A log that is too long for memory: identified in windows, and tested for drift.

An ordinary identification of one window gives the start. Then least squares over all windows, each with a beginning of
its own (`window`), in two or three passes (`passes`): time grows with the length of the record, memory with that of a
window. Noise that is averaged over a day leaves next to nothing, and what the model lacks stays: unless the residual is
seen not to repeat with the motion (`places`), the deviations are the larger, in every direction, of what leaving out
windows says and what leaving out places says (`groups`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import islice

import numpy as np

from jointid.common.errors import MethodError, RecordError
from jointid.common.progress import Progress
from jointid.estimation.identify_record import identify_record
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.methods.registry import Method, default_method
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.build_estimate import (
    build_rows,
    find_at_bound,
    holds_zero,
    list_loop_channels,
    warn_of_bounds,
    warn_of_limit,
)
from jointid.estimation.result.estimate import Checks, Data, Estimate, Fit, Settings, poor_fit
from jointid.estimation.result.params import Params
from jointid.estimation.result.record_fit import Windows
from jointid.estimation.streaming.position_bins import Places, repeats
from jointid.estimation.streaming.segments import drift
from jointid.estimation.streaming.settings import Windowing
from jointid.estimation.streaming.streaming_gauss_newton import End, Pass, Passes
from jointid.estimation.streaming.window import Model, motion, moves, settling_of
from jointid.models.parameters import Parameter, adjusted
from jointid.records.chunks import Chunk, LongRecord
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.uncertainty.covariance import Covariance, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.jackknife import left_out, root_of, total
from jointid.uncertainty.position_dependent_error import Repeatable

_STARTS = 5  # windows that are tried to start from
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator


def identify_log(
    source: LongRecord,
    loop: ClosedLoop,
    settings: Windowing,
    method: Method | None,
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    progress: Progress,
) -> Estimate:
    """Return the estimate of a joint from a long log, torque and reference only, in bounded memory.

    See `jointid.identify`. An interrupt of the last passes ends them, and the estimate is of what was read.
    """
    chosen = method or default_method(loop, loop.joint.model)()
    if not isinstance(chosen, DIDIM | FlexibleDIDIM):
        raise MethodError("A long record is identified by simulating its loop; give the method didim.")
    filtering, wanted = filtering or Filtering(), adjusted(loop.joint.parameters, parameters or {})
    sample_time = source.sample_time
    keep = filtering.resolved(sample_time, loop.joint.model).decimation or 1

    def samples(seconds: float, unit: int = keep) -> int:  # whole rows, so that all windows keep the same samples
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # And whole periods of a controller that is slower than the log: the law's first is at a window's first sample.
    slower = Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
    length = samples(settings.length, math.lcm(keep, slower))
    model = Model(loop, wanted, chosen.free, filtering, samples(settings.settling or settings.length / 20))
    piece, start = _started(source, model, chosen, length, progress)
    known = {p.name: p.value for p in start.params if p.value is not None}
    warnings: list[str] = []
    if settings.settling is None:
        needed = samples(settling_of(model, piece.record, known) * sample_time)
        model = replace(model, settling=min(needed, length // (2 * keep) * keep))
        progress(f"a window forgets how it began in {needed * sample_time:g} s")
        if needed > model.settling:
            warnings.append(
                f"a window forgets how it began in no less than {needed * sample_time:g} s; give longer windows"
            )
    problem = model.problem(piece.record)
    places = Places.of(*motion(problem))
    passes = Passes(source, model, problem.free, length, places, progress)
    end = passes.down(problem.vector(known))
    found = _concluded(source, piece.record, model, problem, end, length)
    return found.amended(checks={"warnings": (*warnings, *found.checks.warnings)})


def _started(
    source: LongRecord, model: Model, method: DIDIM | FlexibleDIDIM, length: int, progress: Progress
) -> tuple[Chunk, Estimate]:
    """Return a window that tells the joint, and what it says.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    changes = {p.name: p for p in model.parameters}
    refusal: RecordError | MethodError | None = None
    moving = (piece for piece in source.chunks(length, 2 * model.settling) if moves(piece.record))
    for piece in islice(moving, _STARTS):
        progress(f"starting from the window that begins at {piece.record.begin:g} s")
        try:
            found = identify_record(
                piece.record, model.loop, method, filtering=model.filtering, parameters=changes, progress=progress
            )
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.params if p.of_joint and p.value is None]
        if not lost:
            return piece, found
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal or MethodError("In no window of this record does the axis move; give another record.")


def _concluded(
    source: LongRecord, first: Record, model: Model, problem: ClosedLoopProblem, end: End, length: int
) -> Estimate:
    """Return the answer that the last pass makes."""
    assert first.torque is not None
    found, joint = end.found, model.loop.joint
    sums = total([w.sums for w in found.windows])
    repeated = repeats(found.places.values(), sums.square, first.torque.unit)
    covariance, intervals = _covariance(found, repeated)
    spread = dict(zip((p.name for p in problem.free), map(float, covariance.std), strict=True))
    values, own = problem.values(end.x), {p.name for p in joint.parameters}
    shown = [p for p in problem.parameters if p.name in own or p.free]
    lost = [p.name for p in problem.free if holds_zero(p, values[p.name], spread[p.name])]
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    error = math.sqrt(sums.square / sums.size) if sums.size > 0 else 0.0
    warnings = [*warn_of_bounds(find_at_bound(problem.free, end.x)), *warn_of_limit(at_limit)]
    loop = problem.loop_at(end.x)
    return Estimate(
        params=Params(
            build_rows(shown, values, spread, joint.unit, own, lost),
            tuple(p.name for p in problem.free),
            covariance.correlation,
            intervals,
        ),
        fit=Fit(
            measured=np.zeros(0),
            predicted=np.zeros(0),
            borders=(0, 0),
            relative_error=math.nan,
            rows=sums.rows,
            filtered_error=error,
            at_limit=at_limit,
            passes=end.passes,
            simulations=end.simulations,
            stop=end.stop,
            converged=end.converged,
            interrupted=not found.ended,
        ),
        checks=Checks(
            known=identifiability(problem.free, problem.units, end.x, root_of(sums), covariance),
            repeatable=repeated,
            drift=drift(found.windows, end.x, problem.free, problem.units),
            warnings=(*warnings, *poor_fit(error)),
        ),
        data=Data(
            torque_unit=first.torque.unit,
            record=source.name,
            channels=list_loop_channels(model.loop, first),
            sample_time=problem.experiment.sample_time,
            windows=Windows(
                length=length * problem.experiment.sample_time,
                settling=model.settling * problem.experiment.sample_time,
                count=len(found.windows),
                still=found.still,
                duration=found.windows[-1].end - found.windows[0].begin,
            ),
        ),
        settings=Settings(
            method="didim",
            variant="DIDIM in windows",
            joint=joint,
            loop=loop,
            filtering=problem.filtering,
            delay=loop.controller.law(problem.experiment.sample_time).delay,
        ),
    )


def _covariance(found: Pass, repeated: Repeatable) -> tuple[Covariance, str]:
    """Return the covariance of the estimate, and what it is, in a sentence.

    Raises:
        MethodError: one window says nothing of how windows differ.
    """
    windows, places = [w.sums for w in found.windows], [p.sums for p in found.places.values()]
    if len(windows) < 2:
        raise MethodError(
            "A long record has two windows or more, in which the axis moves; this one has "
            f"{len(windows)}: give a shorter window, or use identify."
        )
    covariance, said = left_out(windows), f"from leaving out each of {len(windows)} windows"
    if (repeated.significant or repeated.p_value is None) and len(places) > 1:  # what cannot be excluded is covered
        covariance = larger(covariance, left_out(places))
        said += f", or each of {len(places)} places by direction and speed: the larger in every direction"
    return covariance, said
