"""Design a test that identifies a stiffness which a record does not show.

The record gives a lower bound on the stiffness for each load share of the inertia. From the softest joint allowed at a
share to stiffer ones, the relative standard deviation of the compliance is predicted, with all other parameters free
too: with pulses added to the record's own motion, and with a load encoder beside the torque. A test identifies a mode
when that deviation is at most a quarter, so that the 2-sigma interval ends at half of the value. The result is the
highest such mode.

Only the change of the deviation by a test is predicted, not the deviation itself. The bound is where the record's own
motion just excludes a compliance, at 1.645 deviations. On a real axis that is far above the effect of noise with the
spectrum of the residual, because most of a real residual is model error. So all deviations of the torque are enlarged
until the record's own motion gives 1 / 1.645 at the bound.

The joint is lightly damped, and its friction is halved between its sides as in (13).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.common.text import number
from jointid.common.transmission import Transmission, transmission_lines
from jointid.diagnostics.experiment_design import choose_encoder_steps, find_noise_source, rebuild_declared_problem
from jointid.diagnostics.sensor_information import Noise, add_information, compute_encoder_information
from jointid.diagnostics.variations import add_pulses, choose_pulse
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.exploration import FASTEST
from jointid.estimation.search.starts import pseudo_regular
from jointid.models.joints import acts_on_whole
from jointid.models.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Outcome
from jointid.uncertainty.covariance import stationary
from jointid.uncertainty.verdict import StiffnessBound

SHARES = (0.1, 0.33)
"""Load shares of the total inertia for which tests are predicted."""

DETECTED = 0.25
"""Largest relative deviation of an identified compliance: its 2-sigma interval ends at half its value."""

_EXCLUDED = 1 / 1.645  # relative deviation of a compliance that a 95 % bound just excludes
_BAND = 0.15  # of the sampling frequency: up to where the bounds were searched
_STEP = 1.1  # from one mode that is tried to the next
_BISECTIONS = 3  # of the last step


@dataclass(frozen=True, slots=True)
class DetectableMode:
    """Highest mode that one test identifies at one load share.

    Attributes:
        share: of the load in the inertia.
        softest: free-free, Hz, of the softest joint the record allows.
        deviation: relative, of that joint's compliance.
        mode: highest identified, Hz, free-free; None where not even the softest is.
    """

    share: float
    softest: float
    deviation: float
    mode: float | None


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessTestDesign:
    """Tests that would identify a stiffness which a record does not show.

    Attributes:
        record: its name.
        pulses: result with pulses, by load share. height: of the pulses, N or N m. width: s.
        encoder: result with a load encoder, likewise. step: of the encoder, m or rad.
        unit, position_unit: of torque and position.
        transmission: on whose `side` all numbers are.
    """

    record: str
    pulses: tuple[DetectableMode, ...]
    encoder: tuple[DetectableMode, ...]
    height: float
    width: float
    step: float
    unit: str
    position_unit: str
    transmission: Transmission | None = None

    def __str__(self) -> str:
        """Return a line for each test, and one on the modes that the record itself excludes."""
        known = " and ".join(f"{one.softest:.0f} Hz at a load share of {one.share:g}" for one in self.pulses)
        if not known:
            return "This record gives no bound on the stiffness, so no test can be predicted from it."
        pulses = f"pulses of {self.height:.0f} {self.unit} and {1e3 * self.width:.3g} ms added to this motion"
        encoder = f"a load encoder of steps of {number(self.step, 2)} {self.position_unit}"
        tests = (_describe_test(pulses, self.pulses), _describe_test(encoder, self.encoder))
        excluded = f"This record excludes a mode below {known};"
        return "\n".join([*transmission_lines(self.transmission), excluded, f"{tests[0]};", f"{tests[1]}."])


def _describe_test(name: str, modes: tuple[DetectableMode, ...]) -> str:
    identified = [one for one in modes if one.mode is not None]
    if identified:
        highest = " and ".join(f"below {one.mode:.0f} Hz at a load share of {one.share:g}" for one in identified)
        return f"{name} would identify one {highest}"
    excess = min(one.deviation for one in modes) / DETECTED
    if math.isinf(excess):
        return f"{name} would identify none, because such a loop cannot be simulated"
    return f"{name} would not identify even the softest: its deviation is {excess:.1f} times too large"


def design_stiffness_test(
    estimate: Estimate,
    record: Record,
    *,
    pulse: tuple[float, float] | None = None,
    encoder_step: float | None = None,
    noise: Noise | None = None,
    progress: Progress = silent,
) -> StiffnessTestDesign:
    """Predict the modes that pulses or a load encoder would identify where a record does not (see the module).

    Args:
        estimate: by DIDIM of a flexible joint, its stiffness not identifiable.
        record: that it was identified from.
        pulse: height (N or N m) and width (s); None: five times the Coulomb friction, and 1.2 over the cut-off.
        encoder_step: of the load encoder, m or rad; None: that of the record's encoder, or a millionth of the travel.
        noise: where the torque's residual comes from; see `experiment_design.advise`.
        progress: called with the load shares.

    Raises:
        MethodError: the stiffness is identifiable, or the estimate is not of this record.
    """
    if not estimate.checks.bounds:
        raise MethodError(
            "This estimate identifies its stiffness, so no test for it is needed; advise predicts what narrows its "
            "interval."
        )
    problem = _free_both_sides(rebuild_declared_problem(estimate, record)[0])
    sample_time, cutoff = problem.experiment.sample_time, problem.filtering.cutoff
    assert cutoff is not None
    band = Filtering(cutoff=max(_BAND / sample_time, cutoff)).resolved(sample_time, "flexible")
    wide = replace(problem, filtering=band)
    error = wide.filtered(estimate.fit.measured - estimate.fit.predicted)
    rigid = _sum_both_sides(estimate)
    height, width = pulse or choose_pulse(problem, rigid)
    rung = replace(wide, experiment=add_pulses(problem, height, width).experiment)
    step = choose_encoder_steps(record, encoder_step)[1]

    def deviation(by: ClosedLoopProblem, values: Mapping[str, float], doubt: float, encoder: bool) -> float:
        x = by.vector(values)
        response, columns = by.sensitivities(x)
        if response.outcome is not Outcome.FINISHED:
            return math.inf
        J = by.filtered(columns)
        known = doubt**2 * stationary(J, J, error).matrix
        if encoder:
            load = compute_encoder_information(by, x, noise or find_noise_source(record), step, step).load
            assert load is not None
            known = add_information(known, load)
        at = [p.name for p in by.free].index("stiffness")
        return math.sqrt(max(float(known[at, at]), 0.0)) / values["stiffness"]

    def predict_mode(by: ClosedLoopProblem, bound: StiffnessBound, encoder: bool) -> DetectableMode:
        assert bound.frequency is not None
        progress(f"predicting the highest identified mode at a load share of {bound.share:g}")
        softest = pseudo_regular(rigid, bound.frequency, bound.share)
        doubt = max(_EXCLUDED / deviation(wide, softest, 1.0, False), 1.0)

        def deviation_at(mode: float) -> float:
            return deviation(by, pseudo_regular(rigid, mode, bound.share), doubt, encoder)

        return _find_highest_mode(bound.share, bound.frequency, deviation_at, FASTEST / sample_time)

    kind = estimate.settings.joint.kind
    unit = estimate.settings.joint.torque_unit or TORQUE_UNIT[kind]
    bounds = [bound for bound in estimate.checks.bounds if bound.share in SHARES and bound.frequency is not None]
    return StiffnessTestDesign(
        estimate.data.record,
        tuple(predict_mode(rung, bound, False) for bound in bounds),
        tuple(predict_mode(wide, bound, True) for bound in bounds),
        height, width, step, unit, POSITION_UNIT[kind], estimate.settings.joint.transmission,
    )  # fmt: skip


def _free_both_sides(problem: ClosedLoopProblem) -> ClosedLoopProblem:
    """Return the problem with all parameters of motor, load and spring free, fixed ones too."""
    parted = ("motor_", "load_", "stiffness", "damping")
    freed = tuple(replace(p, free=True) if p.name.startswith(parted) else p for p in problem.parameters)
    return replace(problem, parameters=freed)


def _find_highest_mode(
    share: float, softest: float, deviation: Callable[[float], float], fastest: float
) -> DetectableMode:
    """Return the highest mode a test identifies: in steps from the softest joint allowed, the last one bisected."""
    first = now = deviation(softest)
    mode, tried = None, softest
    while now <= DETECTED:
        mode = tried
        if tried == fastest:
            return DetectableMode(share, softest, first, mode)
        tried = min(tried * _STEP, fastest)
        now = deviation(tried)
    for _ in range(_BISECTIONS if mode else 0):
        middle = 0.5 * ((mode or softest) + tried)
        mode, tried = (middle, tried) if deviation(middle) <= DETECTED else (mode, middle)
    return DetectableMode(share, softest, first, mode)


def _sum_both_sides(estimate: Estimate) -> dict[str, float]:
    """Return the values of the whole joint, as those of a rigid joint, from an estimate without a stiffness."""
    assert estimate.checks.known is not None
    found = {known.combination.quantity: known.value for known in estimate.checks.known.physical}
    return found | {p.name: p.value or 0.0 for p in estimate.params if acts_on_whole(p.name) or not p.of_joint}
