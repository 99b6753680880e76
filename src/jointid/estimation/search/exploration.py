"""Where a flexible joint's search begins when nobody knows: a rough rigid joint, then a grid in what is left.

What a drive is known by before anything is identified is its loop: it crosses over where the torque it asks for a
deviation is the torque the inertia needs to follow. A mode of the joint that mattered to whoever tuned the loop lies
not far from there, whatever the joint's size and the rate of the log. So everything is measured by the crossover
frequency: the cut-off of the rigid identification, and the grid of free-free frequencies that is tried.

Half of the grid is an unstable loop, and the rest has local minima: each grid point is simulated once, on a band as
wide as the log; the best few, at frequencies apart, are refined.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.methods.didim import DIDIM, identify_didim
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.nuisance_parameters import INITIAL
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.starts import pseudo_regular
from jointid.models.controllers import SampledLaw
from jointid.models.joints import FlexibleJoint, frequencies
from jointid.models.parameters import Quantity
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.simulation.loop_input import ClosedLoop

RIGID_CUTOFF = 0.005  # of the sampling frequency: the paper's 5 Hz at 1 kHz
FASTEST = 0.22  # of the sampling frequency: a mode faster than about a fifth is not followed by the log
WIDE = 0.4  # of the sampling frequency: the widest band whose edge a filter can still make

_RIGID_BELOW = 0.28  # of the crossover frequency; both are the paper's for its axis
_LOWEST, _HIGHEST = 0.5, 12.0  # times the crossover: the modes that are looked for
_LOWER = (4.0, 4.0)  # times lower cut-offs are tried where a rigid joint cannot be identified
_RATIO = 1.25  # of neighbouring frequencies of the grid
_HALF, _SHARES = 0.5, (0.25, 0.75)  # of the load in the inertia: first the halves of (13), then at the best frequencies
_NARROWED = 3  # frequencies at which other shares are tried
_ROUGH = DIDIM(tolerance=1e-3, step_tolerance=1e-2, iterations=6)  # a start needs no more


def rigid_estimate(record: Record, loop: ClosedLoop, cutoff: float | None, progress: Progress) -> Estimate:
    """Return a rough identification of a flexible joint as rigid, below its resonance.

    Args:
        record: as for the flexible joint.
        loop: of the flexible joint.
        cutoff: Hz; where None, 0.5 % of the sampling frequency, or less for a loop that is slow for its log.
        progress: is told.
    """
    assert isinstance(loop.joint, FlexibleJoint)
    record.require(loop.channels, "DIDIM")
    assert record.torque is not None
    sample_time = record.torque.sample_time
    joint = loop.joint.rigid
    rigid = ClosedLoop(joint, loop.controller)

    def identified(edge: float) -> Estimate:
        progress(f"identifying the joint as rigid, below {edge:.3g} Hz")
        return identify_didim(record, rigid, joint.parameters, Filtering(cutoff=edge), _ROUGH, progress)

    edge = cutoff or RIGID_CUTOFF / sample_time
    found = None
    for lower in () if cutoff else _LOWER:  # a mode below the cut-off may make the joint look like none at all
        try:
            found = identified(edge)
            break
        except MethodError as error:
            progress(f"not below {edge:.3g} Hz: {error}")
            edge /= lower
    found = found or identified(edge)
    law = loop.controller.law(sample_time)
    slow = _RIGID_BELOW * crossover(law, found.values["inertia"])
    if cutoff is None and slow < 0.7 * edge:
        first, found = found, identified(slow)
        found = found.amended(fit={"simulations": first.fit.simulations + found.fit.simulations})
    return found


def crossover(law: SampledLaw, inertia: float) -> float:
    """Return the frequency in Hz up to which the law asks for more torque per position than the inertia takes."""
    hertz = np.geomspace(1e-5, 0.5, 400) / law.period
    loop_gain = np.abs(law.feedback(hertz)) / (abs(inertia) * (2 * math.pi * hertz) ** 2)
    above = np.flatnonzero(loop_gain >= 1.0)
    return float(hertz[above[-1]] if above.size else hertz[0])


def frequencies_to_try(law: SampledLaw, inertia: float, sample_time: float) -> list[float]:
    """Return free-free frequencies in Hz, from below the crossover to where a log cannot follow, slow ones first."""
    middle = crossover(law, inertia)
    low, high = _LOWEST * middle, min(_HIGHEST * middle, FASTEST / sample_time)
    count = max(math.ceil(math.log(max(high / low, 1.0)) / math.log(_RATIO)) + 1, 2)
    return [float(f) for f in np.geomspace(min(low, high), high, count)]


def explored(
    problem: ClosedLoopProblem, rigid: Mapping[str, float], frequencies: Sequence[float], progress: Progress
) -> tuple[list[tuple[float, dict[str, float]]], int]:
    """Return starts as (free-free frequency, values), best first, and the simulations it took.

    Args:
        problem: of the flexible joint, on a wide band.
        rigid: values of a rigid estimate.
        frequencies: to try, Hz.
        progress: is told.

    Raises:
        MethodError: no start can be simulated.
    """
    grid = [(f, _HALF) for f in frequencies]
    costs = dict(zip(grid, _costs(problem, rigid, grid), strict=True))
    best = sorted(grid, key=lambda at: costs[at])[:_NARROWED]
    more = [(f, share) for f, _ in best for share in _SHARES]
    costs |= dict(zip(more, _costs(problem, rigid, more), strict=True))
    if not min(costs.values()) < math.inf:
        raise MethodError(
            "No start could be simulated: every flexible joint tried makes this loop unstable; check the controller's "
            "gains, its delay and the unit of the torque."
        )
    # At frequencies apart, or where only one is tried at load shares apart: a start beside another leads nowhere new.
    apart = [min((at for at in costs if at[0] == f), key=lambda at: costs[at]) for f in frequencies]
    order = sorted(apart if len(frequencies) > 1 else costs, key=lambda at: costs[at])
    progress(f"tried {len(costs)} flexible joints; the best has its mode near {order[0][0]:.3g} Hz")
    starts = [(at[0], started(problem, rigid, *at)) for at in order if costs[at] < math.inf]
    given = {p.name: p.start for p in problem.free if p.start is not None and p.name not in INITIAL}
    if not given:
        return starts, len(costs)
    # Starts that come with the parameters are tried first, and are no reason to try no others.
    own = _inside(problem, starts[0][1] | given)
    usable = min(_cost(problem, own), math.inf) < math.inf
    return [(frequency_of(own), own)] * usable + starts, len(costs) + 1


def started(problem: ClosedLoopProblem, rigid: Mapping[str, float], frequency: float, share: float) -> dict[str, float]:
    """Return the start (13) for the free parameters, within their bounds, with the fixed ones as they are."""
    fixed = {p.name: p.start or 0.0 for p in problem.parameters if not p.free}
    state = {p.name: p.start or 0.0 for p in problem.parameters if p.name in INITIAL}
    nothing = {p.name: p.start or 0.0 for p in problem.parameters}
    return _inside(problem, nothing | pseudo_regular(rigid, frequency, share) | state | fixed)


def frequency_of(values: Mapping[str, float]) -> float:
    """Return the free-free frequency of a joint's values, Hz."""
    return frequencies(values)["free_free"]


def _inside(problem: ClosedLoopProblem, values: dict[str, float]) -> dict[str, float]:
    """Return the values a little inside their bounds, by a thousandth of their size or of what would be one."""
    found = dict(values)
    force = float(np.std(problem.measured))
    rate = 2 * math.pi * frequency_of(values)
    inertia = values["motor_inertia"] + values["load_inertia"]
    typical = {Quantity.FORCE: force, Quantity.VISCOUS: inertia * rate, Quantity.STIFFNESS: inertia * rate**2}
    for p in problem.free:
        inside = 1e-3 * (abs(values[p.name]) or typical.get(p.quantity, inertia))
        low = p.lower + inside if math.isfinite(p.lower) else p.lower
        found[p.name] = min(max(values[p.name], low), max(p.upper - inside, p.lower))
    return found


def _cost(problem: ClosedLoopProblem, values: Mapping[str, float]) -> float:
    """Return the norm of the error; infinite where the loop is as good as unstable."""
    cost = float(np.linalg.norm(problem.residual(problem.vector(values))))
    return cost if cost < 10 * np.linalg.norm(problem.filtered(problem.measured)) else math.inf


def _costs(problem: ClosedLoopProblem, rigid: Mapping[str, float], grid: list[tuple[float, float]]) -> list[float]:
    return in_threads(lambda at: _cost(problem, started(problem, rigid, *at)), grid)
