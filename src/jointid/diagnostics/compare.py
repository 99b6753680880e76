"""The verb `compare`: methods, springs or frictions for one record, or two estimates of one joint.

The registry says which runs a method has in a comparison. Each has the joint's own friction, and the first run of a
method the other law too. A run that is not possible is listed with the reason.

`law_comparison` judges the laws of springs and frictions. A fault of the controller, a delay or dynamics behind the
load may look like another law: check loop and log (`check_loop`) of an estimate with the chosen law.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import TYPE_CHECKING, Literal, overload

import numpy as np

from jointid.common.document import Document, Documented, Facts, Listing, Table, common_facts, data_frame
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Detail, Progress, follow, ignore_progress
from jointid.common.parameters import Parameter
from jointid.common.text import in_words, number, pluralise
from jointid.diagnostics.check_loop import search_faults
from jointid.diagnostics.compare_estimates import LEVEL, EstimateComparison, ReportedEstimate, compare_estimates
from jointid.diagnostics.faults.numbers import DELAY
from jointid.diagnostics.identify import identify
from jointid.diagnostics.law_comparison import LawComparison, compare_laws
from jointid.diagnostics.law_tests import has_unstated_delay
from jointid.diagnostics.model_free import compare_law
from jointid.diagnostics.search_state import LoopTests
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Method, methods
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import show_value
from jointid.models.friction import find_friction
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

if TYPE_CHECKING:
    from pandas import DataFrame

_INTERVAL = 2.0  # deviations: half an interval


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
    didim: DIDIM | None = ...,
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
    didim: DIDIM | None = ...,
    progress: Progress = ...,
) -> MethodComparison: ...


def compare(
    first: Record | ReportedEstimate,
    second: ClosedLoop | Joint | ReportedEstimate,
    among: Literal["methods", "springs", "frictions"] = "methods",
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | None = None,
    level: float = LEVEL,
    progress: Progress = ignore_progress,
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
        >>> found = ji.compare(axis.record, axis.loop, "springs", didim=ji.DIDIM(frequency=30.0))
        >>> found.shown.name
        'linear'
    """
    if isinstance(first, ReportedEstimate) and isinstance(second, ReportedEstimate):
        return compare_estimates(first, second, level)
    if isinstance(first, ReportedEstimate) or isinstance(second, ReportedEstimate):
        raise MethodError("Two estimates are compared, or candidates for a record; received one of each.")
    if not isinstance(first, Record):
        raise MethodError(
            "Candidates are compared for a record, and estimates as `read_report` returns them; received "
            f"{type(first).__name__}: write the estimate to a file, and read it by `read_report`."
        )
    if not isinstance(second, ClosedLoop | Joint):
        raise MethodError(
            f"Candidates are compared for one joint; received {type(second).__name__}: give its loop, or of methods "
            "the joint."
        )
    if among == "methods":
        return compare_methods(
            first, second, filtering=filtering, parameters=parameters, didim=didim, progress=progress
        )
    if not isinstance(second, ClosedLoop):
        raise MethodError(f"{among.capitalize()} are compared in the closed loop; declare the [controller].")
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


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """Result of one method of a comparison.

    Attributes:
        name: of the method, in short.
        estimate: its result; None where it cannot run.
        refusal: why not, in a sentence; "" where it ran.
        seconds: of computing time.
    """

    name: str
    estimate: Estimate | None
    refusal: str
    seconds: float


@dataclass(frozen=True, slots=True, eq=False)
class MethodComparison(Documented):
    """Results of all methods for one record.

    Attributes:
        record: its name.
        model: of the joint.
        methods: in the order they were run.
        disagreements: parameters on which two methods differ by more than both their intervals allow, in sentences.
    """

    record: str
    model: str
    methods: tuple[MethodResult, ...]
    disagreements: tuple[str, ...]

    @property
    def estimates(self) -> dict[str, Estimate]:
        """Estimates of the methods that could run, by name."""
        return {method.name: method.estimate for method in self.methods if method.estimate is not None}

    @property
    def sentence(self) -> str:
        """Sentence of the difference of the methods, and of their stiffness or inertia."""
        found = self.estimates
        ran = f"{len(found)} of {len(self.methods)} methods"
        if len(found) < 2:
            return f"{ran} ran on {self.record}."
        name = "stiffness" if self.model == "flexible" else "inertia"
        rows = [p for e in found.values() for p in e.params.rows if p.name == name and p.value is not None]
        values = [p.value for p in rows if p.value is not None]
        said = (
            f"{name.capitalize()} {number(min(values))} to {number(max(values))} {rows[0].unit}" if rows else "No value"
        )
        differ = "no parameter differs"
        if many := len(self.disagreements):
            differ = f"{pluralise(many, 'parameter')} differ{'s' if many == 1 else ''}"
        return f"{said} by {ran}; {differ} between methods by more than their intervals allow."

    def to_dataframe(self) -> DataFrame:
        """Return the parameters by every method as a pandas data frame: value and standard error, a row each.

        Raises:
            ExtraError: pandas is not installed.
        """
        rows: dict[str, dict[str, object]] = {}
        for name, estimate in self.estimates.items():
            for p in estimate.params.rows:
                if p.of_joint:
                    rows.setdefault(p.name, {"unit": p.unit}).update({name: p.value, f"{name} stderr": p.stderr})
        return data_frame(rows, "parameter")

    def to_document(self, *, details: bool = False) -> Document:
        """Return the table, the channels of each method, and the disagreements; there are no further details."""
        del details
        found = self.estimates
        what = ("joint", f"{self.model}, by every method that {self.record} allows; value ± 2 sigma")
        facts = common_facts(None, next((e.settings.joint.transmission for e in found.values()), None))
        lines = [f"{name} reads {', '.join(estimate.data.channels)}" for name, estimate in found.items()]
        lines += [f"{m.name} cannot run: {m.refusal}" for m in self.methods if m.estimate is None]
        for name, estimate in found.items():
            lines += [f"{name}, {test.name}: {test.sentence}" for test in estimate.checks.tests]
        listing = Listing((*lines, *self.disagreements))
        return Document(self.sentence, (Facts((what, *facts)), *([self._table()] if found else []), listing))

    def _table(self) -> Table:
        found, rows = self.estimates, []
        every = {p.name: p for e in found.values() for p in e.params.rows if p.of_joint}
        for name, one in every.items():
            lines = (next((show_value(p) for p in e.params.rows if p.name == name), "-") for e in found.values())
            rows.append((in_words(name), one.unit, *lines, one.symbol))
        fits = [estimate.fit for estimate in found.values()]
        rows.append(("torque error, raw", "%", *(f"{100 * fit.relative_error:.2f}" for fit in fits), ""))
        rows.append(("filtered", "%", *(f"{100 * fit.filtered_error:.2f}" for fit in fits), ""))
        rows.append(("simulations", "", *(str(fit.simulations) for fit in fits), ""))
        seconds = (f"{method.seconds:.1f}" for method in self.methods if method.estimate is not None)
        rows.append(("time", "s", *seconds, ""))
        return Table(("", "unit", *found, "symbol"), tuple(rows), words=(0, 1, len(found) + 2))


def compare_methods(
    record: Record,
    model: ClosedLoop | Joint,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | None = None,
    progress: Progress = ignore_progress,
) -> MethodComparison:
    """Identify a joint by every method that the record and the model allow.

    Raises:
        RecordError: the record contradicts its description; a method that lacks a channel is part of the result.
    """
    check_record(record)
    tried = []
    listed = list(_list_methods(model, didim))
    for name, variant, method in follow(listed, progress, "comparing methods", len(listed), "methods"):
        progress(Detail(f"trying {name}"))
        joint = variant.joint if isinstance(variant, ClosedLoop) else variant
        has = {p.name for p in joint.parameters}
        changes = {key: change for key, change in (parameters or {}).items() if variant is model or key in has}
        began = time.perf_counter()
        try:
            estimate = identify(record, variant, method, filtering=filtering, parameters=changes, checks=False)
            refusal = ""
        except JointidError as error:
            estimate, refusal = None, str(error)
        tried.append(MethodResult(name, estimate, refusal, time.perf_counter() - began))
    joint = model.joint if isinstance(model, ClosedLoop) else model
    found = MethodComparison(record.name, joint.model, tuple(tried), ())
    return replace(found, disagreements=_describe_disagreements(found.estimates))


def _list_methods(model: ClosedLoop | Joint, didim: DIDIM | None) -> Iterator[tuple[str, ClosedLoop | Joint, Method]]:
    """Yield the name of each method, the model with its friction law, and the method."""
    joint = model.joint if isinstance(model, ClosedLoop) else model
    made = [one.comparison_runs(joint.model) for one in methods()]
    runs = [
        [(label, didim if didim is not None and didim.name == method.name else method) for label, method in each]
        for each in made
        if each
    ]
    for label, method in chain.from_iterable(runs):
        yield label, model, method
    if joint.gravity is not None and joint.gravity.load == "constant":  # not identifiable beside the other law
        return
    other = find_friction(joint.friction.contrast)
    turned = replace(joint, friction=other)
    variant = ClosedLoop(turned, model.controller) if isinstance(model, ClosedLoop) else turned
    for (label, method), *_ in runs:
        yield f"{label} {other.name}", variant, method


def _describe_disagreements(found: Mapping[str, Estimate]) -> tuple[str, ...]:
    """Return a sentence on the worst pair of methods for each parameter on which two differ significantly.

    All use the same record, so their errors are correlated, and two valid methods differ by more far less often than
    once in twenty.
    """
    names = dict.fromkeys(p.name for estimate in found.values() for p in estimate.params.rows if p.of_joint)
    sentences = []
    for name in names:
        rows = {
            key: p
            for key, estimate in found.items()
            for p in estimate.params.rows
            if p.name == name and p.value is not None and p.stderr is not None
        }
        pairs = []
        for one, two in combinations(rows, 2):
            gap = abs((rows[one].value or 0.0) - (rows[two].value or 0.0))
            spread = 2 * float(np.hypot(rows[one].stderr or 0.0, rows[two].stderr or 0.0))
            pairs.append((gap / spread if spread else 0.0, one, two))
        worst, one, two = max(pairs, default=(0.0, "", ""))
        if worst > 1.0:
            both = " and ".join(show_value(replace(rows[key], lack_of_fit=0.0)) for key in (one, two))
            sentences.append(
                f"{one} and {two} disagree on {in_words(name)} outside their intervals: {both} {rows[one].unit}"
            )
    return tuple(sentences)
