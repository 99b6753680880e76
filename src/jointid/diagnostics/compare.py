"""The verb `compare`: springs or frictions for one record, or two estimates of one joint.

`law_comparison` judges the laws of springs and frictions. A fault of the controller, a delay or dynamics behind the
load may look like another law: check loop and log (`check_loop`) of an estimate with the chosen law.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter
from jointid.diagnostics.compare_estimates import LEVEL, EstimateComparison, compare_estimates
from jointid.diagnostics.law_comparison import LawComparison, compare_laws
from jointid.estimation.methods.didim import DIDIM
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering


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
    if not isinstance(first, Record) or among not in ("springs", "frictions"):
        raise MethodError(
            'Two estimates are compared as `to_dict` returns them, or the laws of among = "springs" or "frictions" '
            f"for a record; received {type(first).__name__}, {type(second).__name__} and among = {among!r}."
        )
    if not isinstance(second, ClosedLoop):
        raise MethodError(f"{among.capitalize()} are compared in the closed loop; declare the [controller].")
    return compare_laws(first, second, among, filtering, parameters, didim, progress)
