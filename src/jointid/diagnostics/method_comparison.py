"""Compare all methods that a record allows: where they agree, the result does not depend on the method.

The registry says which runs a method has in a comparison: DIDIM from torque and reference; IDIM by ordinary, weighted
and robust least squares and by instrumental variables, from positions. Each has the joint's own friction, and the first
run of a method the other law too. A run that is not possible is listed with the reason.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, combinations
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.document import Document, Documented, Facts, Listing, Table, common_facts, data_frame
from jointid.common.errors import JointidError
from jointid.common.messages import Progress, follow, ignore_progress
from jointid.common.parameters import Parameter
from jointid.common.text import number, pluralise
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Method, methods
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter
from jointid.models.friction import find_friction
from jointid.models.joints import ClosedLoop, Joint
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

if TYPE_CHECKING:
    from pandas import DataFrame


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
        """How many methods could run, and whether they differ."""
        ran = f"{len(self.estimates)} of {len(self.methods)} methods ran"
        if len(self.estimates) < 2:
            return f"{ran}."
        differ = pluralise(len(self.disagreements), "disagreement") if self.disagreements else "no disagreement"
        return f"{ran}, with {differ} outside their intervals."

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
        title = f"{self.model.capitalize()} joint by every method that {self.record} allows; value +- 2 sigma"
        facts = common_facts(None, next((e.settings.joint.transmission for e in found.values()), None))
        lines = [f"{name} reads {', '.join(estimate.data.channels)}" for name, estimate in found.items()]
        lines += [f"{m.name} cannot run: {m.refusal}" for m in self.methods if m.estimate is None]
        for name, estimate in found.items():
            lines += [f"{name}, {test.name}: {test.sentence}" for test in estimate.checks.tests]
        agreed = ["no two methods differ by more than their intervals allow"] if len(found) > 1 else []
        listing = Listing((*lines, *(self.disagreements or agreed)))
        return Document(title, (Facts(facts), *([self._table()] if found else []), listing))

    def _table(self) -> Table:
        found, rows = self.estimates, []
        symbols = {p.name: (p.symbol, p.unit) for e in found.values() for p in e.params.rows if p.of_joint}
        for name, (symbol, unit) in symbols.items():
            lines = (next((p for p in e.params.rows if p.name == name), None) for e in found.values())
            rows.append((symbol, unit, *map(_format_interval, lines)))
        fits = [estimate.fit for estimate in found.values()]
        rows.append(("torque error, raw", "%", *(f"{100 * fit.relative_error:.2f}" for fit in fits)))
        rows.append(("filtered", "%", *(f"{100 * fit.filtered_error:.2f}" for fit in fits)))
        rows.append(("simulations", "", *(str(fit.simulations) for fit in fits)))
        rows.append(("time", "s", *(f"{method.seconds:.1f}" for method in self.methods if method.estimate is not None)))
        return Table(("", "unit", *found), tuple(rows), words=(0, 1))


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
        progress(f"trying {name}")
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
            sentences.append(
                f"{one} and {two} disagree on {name.replace('_', ' ')} outside their intervals: "
                f"{_format_interval(rows[one])} and {_format_interval(rows[two])} {rows[one].unit}"
            )
    return tuple(sentences)


def _format_interval(p: EstimatedParameter | None) -> str:
    if p is None:
        return "-"
    if p.value is None:
        return "not identifiable"
    return number(p.value) + (f" +- {number(2 * p.stderr, 2)}" if p.stderr is not None else "" if p.free else " fixed")
