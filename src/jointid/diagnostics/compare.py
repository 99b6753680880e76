"""The verb `compare`: methods, springs or frictions for one record, or two estimates of one joint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, overload

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, silent
from jointid.common.parameters import Parameter
from jointid.diagnostics.compare_estimates import LEVEL, EstimateComparison, ReportedEstimate, compare_estimates
from jointid.diagnostics.compare_laws import compare_laws
from jointid.diagnostics.law_comparison import LawComparison
from jointid.diagnostics.method_comparison import MethodComparison, compare_methods
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering


@overload
def compare(first: ReportedEstimate, second: ReportedEstimate, *, level: float = ...) -> EstimateComparison: ...


@overload
def compare(
    first: Record,
    second: ClosedLoop,
    among: Literal["springs", "frictions"],
    *,
    filtering: Filtering | None = ...,
    parameters: Mapping[str, Parameter] | None = ...,
    didim: DIDIM | FlexibleDIDIM | None = ...,
    progress: Progress = ...,
) -> LawComparison: ...


@overload
def compare(
    first: Record,
    second: ClosedLoop | Joint,
    among: Literal["methods"] = ...,
    *,
    filtering: Filtering | None = ...,
    parameters: Mapping[str, Parameter] | None = ...,
    didim: DIDIM | FlexibleDIDIM | None = ...,
    progress: Progress = ...,
) -> MethodComparison: ...


def compare(
    first: Record | ReportedEstimate,
    second: ClosedLoop | Joint | ReportedEstimate,
    among: Literal["methods", "springs", "frictions"] = "methods",
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | FlexibleDIDIM | None = None,
    level: float = LEVEL,
    progress: Progress = silent,
) -> MethodComparison | LawComparison | EstimateComparison:
    """Identify a joint by every candidate that a record allows, or set two estimates side by side.

    Every method that the record and the model allow; or every law of the spring or of friction, each judged on parts of
    the record that were kept from its fit, to say which one the record shows.

    Args:
        first: a record with torque and reference; or the first estimate, from `jointid.output.json.read_report`.
        second: the loop (joint and controller), of methods also the joint alone; or the second estimate.
        among: what is compared for a record.
        filtering: of every fit; see `Filtering`.
        parameters: changes to the joint's parameters by name, for every candidate that has them; those of the declared
            spring or friction for that law only.
        didim: settings of DIDIM; for laws by least squares, and what it frees around the joint is free with each.
        level: of the tests of all quantities of two estimates together.
        progress: called with each step.

    Raises:
        RecordError: the record contradicts its description; a method that lacks a channel is part of the result.
        MethodError: springs of a rigid joint, or laws beside gravity that follows the position, or without a
            controller; a parameter has no such name; the record is too short to keep parts of it; the estimates are not
            of one joint, or the level is no probability.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> found = ji.compare(axis.record, axis.loop, "springs", didim=ji.FlexibleDIDIM(frequency=30.0))
        >>> found.shown.name
        'linear'
    """
    if isinstance(first, ReportedEstimate) and isinstance(second, ReportedEstimate):
        return compare_estimates(first, second, level)
    if isinstance(first, ReportedEstimate) or isinstance(second, ReportedEstimate):
        raise MethodError("Two estimates are compared, or candidates for a record; received one of each.")
    if among == "methods":
        return compare_methods(
            first, second, filtering=filtering, parameters=parameters, didim=didim, progress=progress
        )
    if not isinstance(second, ClosedLoop):
        raise MethodError(f"{among.capitalize()} are compared in the closed loop; declare the [controller].")
    return compare_laws(
        first, second, among, filtering=filtering, parameters=parameters, didim=didim, progress=progress
    )
