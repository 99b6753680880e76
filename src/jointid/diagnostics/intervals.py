"""Intervals of an estimate by profiles of the criterion and by bootstraps over time and over position.

The intervals in an estimate's table come from the slopes of the criterion at one point. A profile follows the criterion
itself, which matters where it is not a parabola, as for a stiffness that is barely identifiable; a bootstrap resamples
the residual. Both start from an estimate and its record.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Heading, Listing, common_facts
from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.common.transmission import Transmission
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.nuisance_parameters import surrounding
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.records.record import Record
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.problem import Problem
from jointid.uncertainty.bootstrap import Bootstrap, Bootstrapping, cell_bootstrap, refitted, time_bootstrap
from jointid.uncertainty.combination import ByCompliance, Combination
from jointid.uncertainty.covariance import Covariance, covariance_of
from jointid.uncertainty.position_dependent_error import uncertainty
from jointid.uncertainty.profile import Profile, Profiling, profile

_LEAST = 1e-4  # of the compliance: a smaller one is negligible


@dataclass(frozen=True, slots=True, eq=False)
class Intervals(Documented):
    """Intervals of an estimate by profiles and bootstraps.

    Attributes:
        profiles: of the quantities asked for.
        over_time: the bootstrap over blocks of time; None where it was not asked for, as the next.
        over_place: the bootstrap over stretches of position, direction and speed.
        transmission: on whose `side` all numbers are.
    """

    profiles: tuple[Profile, ...]
    over_time: Bootstrap | None
    over_place: Bootstrap | None
    transmission: Transmission | None = None

    def document(self, *, details: bool = False) -> Document:
        """Return profiles and bootstraps one after the other; there are no further details."""
        del details
        facts = common_facts(None, self.transmission)
        blocks: list[Block] = [Facts(facts)] if facts else []
        blocks += [Listing(tuple(map(str, self.profiles)))] if self.profiles else []
        drawn = [one.document() for one in (self.over_time, self.over_place) if one is not None]
        parts = (block for each in drawn for block in (Heading(each.title), *each.blocks))
        return Document("Intervals, by other ways than the covariance", (*blocks, *parts))


def intervals(
    estimate: Estimate,
    record: Record,
    quantities: Sequence[str] = (),
    *,
    bootstrap: bool = False,
    refit: bool = False,
    profiling: Profiling | None = None,
    bootstrapping: Bootstrapping | None = None,
    progress: Progress = silent,
) -> Intervals:
    """Return profiles and bootstraps of an estimate by DIDIM.

    Args:
        estimate: of the record.
        record: it came from.
        quantities: to profile: names of free parameters, "compliance" for 1/K12, or sums and differences of parameters,
            "motor_viscous + load_viscous".
        bootstrap: True to bootstrap as well.
        refit: True for a whole least-squares fit of every draw; one linear step otherwise.
        profiling: see `Profiling`.
        bootstrapping: see `Bootstrapping`.
        progress: called with each quantity.

    Raises:
        MethodError: the estimate is not by DIDIM or lacks a parameter, a quantity is unknown, or the record is
            another one.
    """
    problem, x = rebuild_problem(estimate, record)
    residual, J = problem.linearised(x)
    names = [p.name for p in problem.free]
    where = problem.cells(problem.simulate(x))
    spread = uncertainty(J, J, residual, where, names, problem.torque_unit).covariance
    profiles = []
    for quantity in quantities:
        progress(f"profiling {quantity}")
        profiles.append(_profile_quantity(problem, x, spread, quantity, profiling))
    if not bootstrap:
        return Intervals(tuple(profiles), None, None, estimate.settings.joint.transmission)
    progress("bootstrapping over time and over position")
    again = refitted(problem, x) if refit else None
    over_time = time_bootstrap(problem.free, x, residual, J, bootstrapping, again)
    over_place = cell_bootstrap(problem.free, x, residual, J, where.stretch, bootstrapping, again)
    return Intervals(tuple(profiles), over_time, over_place, estimate.settings.joint.transmission)


def require_quantities(quantities: Sequence[str], loop: ClosedLoop) -> None:
    """Raise a `MethodError` for a quantity that no estimate of this loop can have, free or not.

    Args:
        quantities: see `intervals`.
        loop: joint and controller.
    """
    known = [p.name for p in loop.joint.parameters]
    for quantity in quantities:
        if quantity == "compliance" and "stiffness" in known:
            continue
        for name in _parse_weights(quantity):
            if name not in known:
                try:
                    surrounding(name, loop.controller)
                except MethodError:
                    raise MethodError(_explain_unknown(quantity, known)) from None


def rebuild_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the problem an estimate by DIDIM solved, and its free parameters.

    Raises:
        MethodError: see `intervals`.
    """
    if estimate.settings.loop is None or estimate.settings.method != "didim":
        raise MethodError(
            f"Profiles and bootstraps are of DIDIM, whose criterion can be followed; this estimate is by "
            f"{estimate.settings.method.upper()}: identify with the controller known."
        )
    values = estimate.identified.values | {p.name: p.value or 0.0 for p in estimate.params if not p.of_joint}
    record.require(("torque",), "A profile")
    assert record.torque is not None
    if fingerprint(record.torque.values) != estimate.data.fingerprint:
        raise MethodError(
            f"This record is not the one the estimate came from ({estimate.data.record}); give that one, "
            "or identify this."
        )
    free = {p.name for p in estimate.params if p.free}
    problem = torque_problem(
        record, estimate.settings.loop, estimate.settings.filtering, estimate.settings.loop.joint.parameters
    )
    more = [p.name for p in estimate.params if not p.of_joint and p.name not in problem.units]
    problem = problem.freeing(*more) if more else problem
    kept = tuple(p if p.name in free else p.fixed(values[p.name]) for p in problem.parameters)
    problem = replace(problem, parameters=kept)
    return problem, problem.vector(values)


def _profile_quantity(
    problem: ClosedLoopProblem, x: FloatArray, spread: Covariance, quantity: str, settings: Profiling | None
) -> Profile:
    if quantity != "compliance":
        return profile(problem, x, _parse_combination(problem, quantity), spread, settings)
    names = [p.name for p in problem.free]
    if "stiffness" not in names:
        raise MethodError("A compliance is that of a flexible joint whose stiffness is free; this joint has none.")
    at = names.index("stiffness")
    by: Problem = ByCompliance(problem, _LEAST / float(x[at]))
    turn = np.eye(x.size)
    turn[at, at] = -1.0 / float(x[at]) ** 2  # of 1/K by K
    turned = covariance_of(turn @ spread.matrix @ turn.T, spread.bandwidth)
    exchanged = x.copy()
    exchanged[at] = 1.0 / x[at]
    wanted = Combination("compliance", "1/K12", problem.loop.joint.unit(by.free[at]), {"compliance": 1.0})
    return profile(by, exchanged, wanted, turned, settings)


def _parse_combination(problem: ClosedLoopProblem, quantity: str) -> Combination:
    """Return the combination of parameters in a text such as ``a + b - c``."""
    weights = _parse_weights(quantity)
    free = {p.name: p for p in problem.free}
    if not weights.keys() <= free.keys():
        raise MethodError(_explain_unknown(quantity, free))
    units = {problem.units[name] for name in weights}
    if len(units) > 1:
        raise MethodError(f'"{quantity}" adds {" and ".join(sorted(units))}; only what has one unit can be added.')
    signed = [("- " if weight < 0 else "+ ") + free[name].symbol for name, weight in weights.items()]
    formula = " ".join(signed).removeprefix("+ ")
    return Combination(quantity, formula, units.pop(), weights)


def _parse_weights(quantity: str) -> dict[str, float]:
    """Return the sign of each parameter in a text such as ``a + b - c``, by name."""
    terms = quantity.replace("-", "+-").split("+")
    found = {term.strip().removeprefix("-").strip(): -1.0 if "-" in term else 1.0 for term in terms if term.strip()}
    return found or {quantity: 1.0}


def _explain_unknown(quantity: str, names: Collection[str]) -> str:
    """Return the message for a text that is no quantity of an estimate with these parameters."""
    compliance = ", or compliance" if "stiffness" in names else ""
    return (
        f'"{quantity}" is no quantity of this estimate; name a free parameter ({", ".join(names)}), or a sum or '
        f"difference of some{compliance}."
    )
