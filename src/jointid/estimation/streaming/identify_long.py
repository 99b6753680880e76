"""The verb for a record that is too long for memory: it is identified in windows, and watched for drift.

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
from jointid.common.progress import Progress, silent
from jointid.estimation.identify import Method, default_method, identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate, poor_fit
from jointid.estimation.result.estimated import EstimatedParameter
from jointid.estimation.streaming.long_estimate import LongEstimate
from jointid.estimation.streaming.position_bins import Places, repeats
from jointid.estimation.streaming.segments import drift
from jointid.estimation.streaming.streaming_gauss_newton import End, Pass, Passes
from jointid.estimation.streaming.window import Model, motion, moves, settling_of
from jointid.models.parameters import Parameter, Quantity, adjusted
from jointid.records.chunks import InMemory, LongRecord, Piece
from jointid.records.record import Record
from jointid.records.signals import Filtering
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.bounds import Bounds
from jointid.uncertainty.covariance import Covariance, larger
from jointid.uncertainty.identifiability import identifiability
from jointid.uncertainty.jackknife import left_out, root_of, total
from jointid.uncertainty.position_dependent_error import Repeatable

_STARTS = 5  # windows that are tried to start from
_CLOCKS = 1000  # a period of the controller is taken to be a fraction of samples with no larger denominator
_AT_LIMIT = 0.01  # of the periods: more is said


def identify_long(
    record: LongRecord | Record,
    loop: ClosedLoop,
    *,
    window: float = 60.0,
    settling: float | None = None,
    method: Method | None = None,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    progress: Progress = silent,
) -> LongEstimate:
    """Identify a joint from a long record, torque and reference only, in bounded memory.

    Args:
        record: a `Log`, which is read in pieces, or a record in memory; all channels at one rate.
        loop: joint and controller.
        window: seconds that count in a window, up to whole rows and periods of the controller: a few cycles of the
            motion, so that one of them tells the joint roughly.
        settling: seconds that are simulated before and after each window and do not count: what the loop takes to
            forget how it began. None measures that on the first window, and takes half a window at most.
        method: `DIDIM` (rigid) or `FlexibleDIDIM`, of the window that is started from; what it has `free` is free here.
        filtering: see `Filtering`.
        parameters: changes to the joint's parameters by name: fixed values, starts, bounds.
        progress: is told each step in a sentence.

    An interrupt of the last passes ends them, and the answer is of what was read of it: `LongEstimate.interrupted`.

    Raises:
        RecordError: a piece of the record cannot be read, or lacks a channel; the sentence says where.
        MethodError: the method simulates no loop, no window tells the joint, or a window cannot be simulated.

    Example:
        >>> import jointid as ji
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=100.0, kv=2000.0))
        >>> reference = ji.trapezoids((0.1, 0.2), 2.0, 0.1, 1e-3, duration=60.0)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> estimate = ji.identify_long(record, loop, window=6.0)
        >>> print(round(estimate["inertia"].value, 3), estimate.windows)
        30.0 10
    """
    chosen = method or default_method(loop.joint, True)
    if not isinstance(chosen, DIDIM | FlexibleDIDIM):
        raise MethodError("A long record is identified by simulating its loop; give the method didim.")
    if not 0.0 < window < math.inf:
        raise MethodError(f"A window lasts a finite time; received {window:g} s.")
    if settling is not None and not 0.0 < settling <= 0.5 * window:
        raise MethodError(
            f"The settling time is more than 0 and at most half a window of {window:g} s; received {settling:g} s. "
            "Without it, it is measured."
        )
    source = InMemory(record) if isinstance(record, Record) else record
    filtering, wanted = filtering or Filtering(), adjusted(loop.joint.parameters, parameters or {})
    sample_time = source.sample_time
    keep = filtering.resolved(sample_time, loop.joint.model).decimation or 1

    def samples(seconds: float, unit: int = keep) -> int:  # whole rows, so that all windows keep the same samples
        return unit * math.ceil(seconds / (sample_time * unit) - 1e-9)

    # And whole periods of a controller that is slower than the log: the law's first is at a window's first sample.
    slower = Fraction(loop.controller.law(sample_time).period / sample_time).limit_denominator(_CLOCKS).numerator
    length = samples(window, math.lcm(keep, slower))
    model = Model(loop, wanted, chosen.free, filtering, samples(settling or window / 20))
    piece, start = _started(source, model, chosen, length, progress)
    known = {p.name: p.value for p in start.parameters if p.value is not None}
    warnings: list[str] = []
    if settling is None:
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
    return replace(found, warnings=(*warnings, *found.warnings))


def _started(
    source: LongRecord, model: Model, method: DIDIM | FlexibleDIDIM, length: int, progress: Progress
) -> tuple[Piece, Estimate]:
    """Return a window that tells the joint, and what it says.

    Raises:
        RecordError, MethodError: none of the first does; what is wrong with the last that was tried.
    """
    changes = {p.name: p for p in model.parameters}
    refusal: RecordError | MethodError | None = None
    moving = (piece for piece in source.pieces(length, 2 * model.settling) if moves(piece.record))
    for piece in islice(moving, _STARTS):
        progress(f"starting from the window that begins at {piece.record.begin:g} s")
        try:
            found = identify(
                piece.record, model.loop, method, filtering=model.filtering, parameters=changes, progress=progress
            )
        except (RecordError, MethodError) as error:
            refusal = error
            continue
        lost = [p.name for p in found.parameters if p.of_joint and p.value is None]
        if not lost:
            return piece, found
        refusal = MethodError(
            f"A window does not tell {', '.join(lost)}; give a longer window, or identify the joint as rigid."
        )
    raise refusal or MethodError("In no window of this record does the axis move; give another record.")


def _concluded(
    source: LongRecord, first: Record, model: Model, problem: ClosedLoopProblem, end: End, length: int
) -> LongEstimate:
    """Return the answer that the last pass makes."""
    assert first.torque is not None
    found, joint = end.found, model.loop.joint
    sums = total([w.sums for w in found.windows])
    repeated = repeats(found.places.values(), sums.square, first.torque.unit)
    covariance, intervals = _covariance(found, repeated)
    spread = dict(zip((p.name for p in problem.free), map(float, covariance.std), strict=True))
    values, own = problem.values(end.x), {p.name for p in joint.parameters}
    shown = [p for p in problem.parameters if p.name in own or p.free]
    at_limit = float(np.mean([w.at_limit for w in found.windows]))
    error = math.sqrt(sums.square / sums.size) if sums.size > 0 else 0.0
    reached = Bounds.of(problem.free).reached(end.x)
    held = [p.name for p, at in zip(problem.free, reached, strict=True) if at]
    warnings = [f"{name} is at its bound, where it does not follow the record" for name in held]
    if at_limit > _AT_LIMIT:
        warnings.append(
            f"the controller is at its limit in {100 * at_limit:.1f} % of the periods, where the torque says nothing "
            "of the joint"
        )
    return LongEstimate(
        joint=joint,
        loop=problem.loop_at(end.x),
        torque_unit=first.torque.unit,
        parameters=tuple(_row(p, values[p.name], spread.get(p.name), problem, p.name in own) for p in shown),
        correlation=covariance.correlation,
        known=identifiability(problem.free, problem.units, end.x, root_of(sums), covariance),
        repeatable=repeated,
        drift=drift(found.windows, end.x, problem.free, problem.units),
        record=source.name,
        channels=(*model.loop.channels, *(("injected",) if first.injected is not None else ())),
        sample_time=problem.experiment.sample_time,
        window=length * problem.experiment.sample_time,
        settling=model.settling * problem.experiment.sample_time,
        windows=len(found.windows),
        still=found.still,
        duration=found.windows[-1].end - found.windows[0].begin,
        rows=sums.rows,
        filtered_error=error,
        filtering=problem.filtering,
        at_limit=at_limit,
        passes=end.passes,
        simulations=end.simulations,
        stop=end.stop,
        converged=end.converged,
        interrupted=not found.ended,
        intervals=intervals,
        warnings=(*warnings, *poor_fit(error)),
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


def _row(
    p: Parameter, value: float, std: float | None, problem: ClosedLoopProblem, of_joint: bool
) -> EstimatedParameter:
    physical = p.quantity in (Quantity.INERTIA, Quantity.STIFFNESS)
    told = std is not None and not (physical and value <= 2 * std)
    return EstimatedParameter(
        p.name, p.symbol, problem.units[p.name], value, std, p.free, told, of_joint=of_joint
    )  # fmt: skip
