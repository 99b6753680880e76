"""The verb `compare`: springs or frictions for one record, or two estimates of one joint.

`law_comparison` judges the laws of springs and frictions. A fault of the controller, a delay or dynamics behind the
load may look like another law: check loop and log (`check_loop`) of an estimate with the chosen law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, overload

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.diagnostics.check_loop import search_faults
from jointid.diagnostics.compare_estimates import LEVEL, EstimateComparison, compare_estimates
from jointid.diagnostics.faults.numbers import DELAY
from jointid.diagnostics.law_comparison import LawComparison, compare_laws
from jointid.diagnostics.law_tests import has_unstated_delay
from jointid.diagnostics.model_free import compare_law
from jointid.diagnostics.search_state import LoopTests
from jointid.estimation.methods.didim import DIDIM
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

_INTERVAL = 2.0  # deviations: half an interval


@overload
def compare(first: Mapping[str, Any], second: Mapping[str, Any], *, level: float = ...) -> EstimateComparison: ...


@overload
def compare(
    first: Record,
    second: ClosedLoop,
    among: Literal["springs", "frictions"],
    *,
    filtering: Filtering | None = ...,
    parameters: Mapping[str, Parameter] | None = ...,
    didim: DIDIM | None = ...,
    progress: Progress = ...,
) -> LawComparison: ...


def compare(
    first: Record | Mapping[str, Any],
    second: ClosedLoop | Mapping[str, Any],
    among: Literal["springs", "frictions"] | None = None,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | None = None,
    level: float = LEVEL,
    progress: Progress = ignore_progress,
) -> LawComparison | EstimateComparison:
    """Identify a joint with every law of its spring or friction, or set two estimates side by side.

    Each law is judged on parts of the record that were kept from its fit, to say which one the record shows.

    Args:
        first: a record with torque and reference; or the first estimate, as `to_dict` gives it.
        second: the loop (joint and controller); or the second estimate.
        among: what is compared for a record.
        filtering: of every fit; see `Filtering`.
        parameters: changes to the joint's parameters by name, for every law that has them; those of the declared
            spring or friction for that law only.
        didim: settings of DIDIM, by least squares, and what it frees around the joint is free with each.
        level: of the tests of all quantities of two estimates together.
        progress: called with each step.

    Raises:
        RecordError: the record contradicts its description, or no estimate is given.
        MethodError: springs of a rigid joint, or laws beside gravity that follows the position, or without a
            controller; a parameter has no such name; the record is too short to keep parts of it; the estimates are not
            of one joint, or the level is no probability.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> found = ji.compare(axis.record, axis.loop, "springs", didim=ji.DIDIM(frequency=30.0))
        >>> found.shown.name
        'linear'
    """
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return compare_estimates(first, second, level)
    if not (isinstance(first, Record) and isinstance(second, ClosedLoop)):
        raise MethodError(
            "Laws are compared for a record in its closed loop, estimates by what `to_dict` returned of them; received "
            f"{type(first).__name__} and {type(second).__name__}: declare the [controller], or give two estimates."
        )
    if among not in ("springs", "frictions"):
        raise MethodError('Laws are compared for a record; say which by among = "springs" or "frictions".')
    return _compare_laws(first, second, among, filtering, parameters, didim, progress)


def _compare_laws(
    record: Record,
    loop: ClosedLoop,
    among: Literal["springs", "frictions"],
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    didim: DIDIM | None,
    progress: Progress,
) -> LawComparison:
    """Identify a joint with every law of its spring or friction, and with an unstated delay that the shown one has."""
    settings = didim or DIDIM()
    judged, end = compare_laws(record, loop, among, filtering, parameters, settings, progress)
    followed = compare_law(record, loop)
    if followed is None or not followed.holds or end is None or DELAY.name in settings.free:
        return judged
    asked = LoopTests(most=1, faults=(DELAY.name,))
    check, _ = search_faults(end.problem, end.solution.x, asked, record=record, law=followed)
    moved = (by.sigmas for one in check.findings for by in one.changes.values())
    if not has_unstated_delay(check, followed, end.problem) or all(abs(by) <= _INTERVAL for by in moved):
        return judged
    progress("the torque acts within a sample after its log: the delay is identified with every law")
    freed = replace(settings, free=(*settings.free, DELAY.name))
    return compare_laws(record, loop, among, filtering, parameters, freed, progress)[0]
