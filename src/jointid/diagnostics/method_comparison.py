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

import numpy as np

from jointid.common.document import Block, Document, Documented, Facts, Listing, Table, common_facts
from jointid.common.errors import JointidError
from jointid.common.progress import Progress, silent
from jointid.common.text import number
from jointid.estimation.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.methods.registry import Method, methods
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.params import EstimatedParameter
from jointid.models.friction import friction_named
from jointid.models.joints import Joint
from jointid.models.parameters import Parameter
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.loop_input import ClosedLoop


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

    def document(self, *, details: bool = False) -> Document:
        """Return the table, what each method read, and where they differ; there are no further details."""
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
        blocks: list[Block] = [Facts(facts)] if facts else []
        blocks += [_make_table(self)] if found else []
        return Document(title, (*blocks, listing))


def compare_methods(
    record: Record,
    model: ClosedLoop | Joint,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | FlexibleDIDIM | None = None,
    progress: Progress = silent,
) -> MethodComparison:
    """Identify a joint by every method that the record and the model allow.

    Args:
        record: to identify from.
        model: the loop (joint and controller), or the joint alone when the controller is not known.
        filtering: of every method; see `Filtering`.
        parameters: changes to the joint's parameters by name; with the other friction law, those that it has too.
        didim: settings of DIDIM.
        progress: called with each method's name.

    Raises:
        RecordError: the record contradicts its description; a method that lacks a channel is part of the result.
    """
    check_record(record)
    tried = []
    for name, variant, method in _list_methods(model, didim):
        progress(f"trying {name}")
        joint = variant.joint if isinstance(variant, ClosedLoop) else variant
        has = {p.name for p in joint.parameters}
        changes = {key: change for key, change in (parameters or {}).items() if variant is model or key in has}
        began = time.perf_counter()
        try:
            estimate = identify(record, variant, method, filtering=filtering, parameters=changes)
            refusal = ""
        except JointidError as error:
            estimate, refusal = None, str(error)
        tried.append(MethodResult(name, estimate, refusal, time.perf_counter() - began))
    joint = model.joint if isinstance(model, ClosedLoop) else model
    return MethodComparison(record.name, joint.model, tuple(tried), _describe_disagreements(tried))


def _list_methods(
    model: ClosedLoop | Joint, didim: DIDIM | FlexibleDIDIM | None
) -> Iterator[tuple[str, ClosedLoop | Joint, Method]]:
    """Yield the name of each method, the model with its friction law, and the method."""
    joint = model.joint if isinstance(model, ClosedLoop) else model
    runs = [made.compared(joint.model) for made in methods() if joint.model in made.models]
    runs = [tuple((label, _chosen(method, didim)) for label, method in each) for each in runs if each]
    for label, method in chain.from_iterable(runs):
        yield label, model, method
    if joint.gravity is not None and joint.gravity.load == "constant":  # not identifiable beside the other law
        return
    other = friction_named(joint.friction.contrast)
    turned = replace(joint, friction=other)
    variant = ClosedLoop(turned, model.controller) if isinstance(model, ClosedLoop) else turned
    for (label, method), *_ in runs:
        yield f"{label} {other.name}", variant, method


def _chosen(method: Method, given: Method | None) -> Method:
    """Return the settings that are given instead of a method's own, if they are of it."""
    return given if given is not None and given.name == method.name else method


def _describe_disagreements(tried: list[MethodResult]) -> tuple[str, ...]:
    """Return a sentence on the worst pair of methods for each parameter on which two differ significantly.

    All use the same record, so their errors are correlated, and two valid methods differ by more far less often than
    once in twenty.
    """
    found = {method.name: method.estimate for method in tried if method.estimate is not None}
    names = dict.fromkeys(p.name for estimate in found.values() for p in estimate.params if p.of_joint)
    sentences = []
    for name in names:
        rows = {
            key: p
            for key, estimate in found.items()
            for p in estimate.params
            if p.name == name and p.value is not None and p.stderr is not None
        }
        pairs = [(_measure_gap(rows[one], rows[two]), one, two) for one, two in combinations(rows, 2)]
        worst, one, two = max(pairs, default=(0.0, "", ""))
        if worst > 1.0:
            first, second = rows[one], rows[two]
            sentences.append(
                f"{one} and {two} disagree on {name.replace('_', ' ')} beyond their intervals: "
                f"{_format_interval(first)} and {_format_interval(second)} {first.unit}"
            )
    return tuple(sentences)


def _measure_gap(one: EstimatedParameter, two: EstimatedParameter) -> float:
    """Return the difference of two estimates of one parameter over its 2-sigma interval."""
    assert one.value is not None
    assert two.value is not None
    spread = 2 * float(np.hypot(one.stderr or 0.0, two.stderr or 0.0))
    return abs(one.value - two.value) / spread if spread else 0.0


def _format_interval(p: EstimatedParameter | None) -> str:
    if p is None:
        return "-"
    if p.value is None:
        return "not identifiable"
    return number(p.value) + (f" +- {number(2 * p.stderr, 2)}" if p.stderr is not None else "" if p.free else " fixed")


def _make_table(comparison: MethodComparison) -> Table:
    found = comparison.estimates
    seconds = {method.name: method.seconds for method in comparison.methods}
    symbols: dict[str, tuple[str, str]] = {}
    for estimate in found.values():
        symbols |= {p.name: (p.symbol, p.unit) for p in estimate.params if p.of_joint}
    rows = []
    for name, (symbol, unit) in symbols.items():
        lines = [next((p for p in e.params if p.name == name), None) for e in found.values()]
        rows.append((symbol, unit, *map(_format_interval, lines)))
    of_each = found.values()
    rows.append(("torque error, raw", "%", *(f"{100 * e.fit.relative_error:.2f}" for e in of_each)))
    rows.append(("filtered", "%", *(f"{100 * e.fit.filtered_error:.2f}" for e in of_each)))
    rows.append(("simulations", "", *(str(e.fit.simulations) for e in of_each)))
    rows.append(("time", "s", *(f"{seconds[name]:.1f}" for name in found)))
    return Table(("", "unit", *found), tuple(rows), words=(0, 1))
