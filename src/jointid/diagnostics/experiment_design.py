"""Prediction of the intervals of an estimate with other sensors or another motion.

`advise` takes an estimate and its record. The change of the reported covariance is predicted from exact sensitivities
at the estimate.

- A sensor adds its information to that of the torque (`other_experiments`).
- A motion is simulated at the estimate and gives other sensitivities J. The covariance of least squares with the
  spectrum of the record's residual (`uncertainty.covariance.stationary`) is compared with that of the record's own
  motion. The spectrum stays the same under the same disturbance, but not with friction that repeats with the motion.

`design_stiffness_test` searches for a test that identifies the stiffness if a record does not. The record gives a lower
bound on the stiffness for each load share of the inertia. From the softest joint at a share to stiffer ones, the
relative standard deviation of the compliance is predicted with all other parameters free: with pulses added to the
record's own motion, and with a load encoder beside the torque. A test identifies a mode if that deviation is at most a
quarter, so that the 2-sigma interval ends at half of the value. The result is the highest such mode.

Only the change of the deviation by a test is predicted, not the deviation itself. The bound is where the record's own
motion just excludes a compliance, at 1.645 deviations. On a real axis that is far above the effect of noise with the
spectrum of the residual, because most of a real residual is model error. So all deviations of the torque are enlarged
until the record's own motion gives 1 / 1.645 at the bound. The joint is lightly damped, and its friction is halved
between its sides as in (13).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph, Table, common_facts
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, Work, follow, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import in_words, number
from jointid.common.transmission import Transmission, transmission_lines
from jointid.diagnostics.intervals import rebuild_problem
from jointid.diagnostics.other_experiments import (
    Noise,
    add_information,
    add_pulses,
    choose_encoder_steps,
    choose_pulse,
    compute_encoder_information,
    double_acceleration,
)
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.starts.flexible_joint import FASTEST, pseudo_regular
from jointid.models.joints import acts_on_whole
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.controller_torque import SeenPosition
from jointid.uncertainty.covariance import covariance_of, stationary
from jointid.uncertainty.verdict import StiffnessBound

SHARES = (0.1, 0.33)
"""Load shares of the total inertia for which tests are predicted."""

DETECTED = 0.25
"""Largest relative deviation of an identified compliance: its 2-sigma interval ends at half its value."""

_WORTH = 0.8  # of a deviation: a smaller gain is not worth a sentence
_ALIKE = 1.05  # times the least share of an interval
_EXCLUDED = 1 / 1.645  # relative deviation of a compliance that a 95 % bound just excludes
_BAND = 0.15  # of the sampling frequency: up to where the bounds were searched
_STEP = 1.1  # from one mode that is tried to the next
_BISECTIONS = 3  # of the last step


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted standard deviations under one change of sensors or motion.

    Attributes:
        name: of the change, a word or two.
        description: of the change, with its numbers.
        std: predicted standard deviations by name; empty where the loop cannot be simulated under it.
    """

    name: str
    description: str
    std: Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Advice(Documented):
    """Predicted standard deviations of an estimate with other sensors and motions.

    Attributes:
        record: its name.
        noise: where the torque's residual is taken to come from: "loop" or "log".
        symbols, units: of the parameters of the joint that were free, by name.
        std: their standard deviations as reported.
        sensors: predictions for encoders beside the torque.
        tests: predictions for other motions, of the same duration, from the torque alone.
        transmission: on whose `side` all numbers are.
    """

    record: str
    noise: Noise
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    std: Mapping[str, float]
    sensors: tuple[Prediction, ...]
    tests: tuple[Prediction, ...]
    transmission: Transmission | None = None

    @property
    def sentences(self) -> tuple[str, ...]:
        """The interval that each change narrows most, a sentence each."""
        return tuple(self._sentence(one) for one in (*self.sensors, *self.tests))

    @property
    def sentence(self) -> str:
        """Sentence of the change that narrows an interval most; of two alike, the simpler."""
        left = [
            (min(std / self.std[name] for name, std in one.std.items()), one)
            for one in (*self.sensors, *self.tests)
            if one.std
        ]
        least = min((share for share, _ in left), default=1.0)
        if least > _WORTH:
            return "No encoder and no motion that was tried narrows an interval by more than a fifth."
        best = next(one for share, one in left if share <= _ALIKE * least)
        name = min(best.std, key=lambda n: best.std[n] / self.std[n])
        what = best.description if best in self.tests else f"a {best.name}" if best.name != "both" else "both encoders"
        return (
            f"Most is gained by {what}: {in_words(name)} {self.symbols[name]} known to "
            f"± {number(2 * best.std[name], 2)} instead of ± {number(2 * self.std[name], 2)} {self.units[name]}."
        )

    def _sentence(self, change: Prediction) -> str:
        if not change.std:
            return f"{change.name}: {change.description}; the loop cannot be simulated with it"
        name = min(change.std, key=lambda n: change.std[n] / self.std[n])
        before, after = self.std[name], change.std[name]
        if after > _WORTH * before:
            return f"{change.name}: {change.description}; narrows no interval by more than a fifth"
        return (
            f"{change.name}: {change.description}; narrows {self.symbols[name]} most, from ± {number(2 * before, 2)} "
            f"to ± {number(2 * after, 2)} {self.units[name]}"
        )

    def to_document(self, *, details: bool = False) -> Document:
        """Return a table for sensors, one for tests, and a sentence each; there are no further details."""
        del details
        where = {
            "loop": "caused by a force inside the loop; noise of the log alone would give narrower intervals",
            "log": "measurement noise of the log; a force inside the loop would give wider intervals",
        }[self.noise]
        said = Paragraph(f"2-sigma intervals as {self.record} has them; the torque residual is taken to be {where}")
        blocks: list[Block] = [said, Facts(common_facts(None, self.transmission))]
        for kind, group in (("torque and", self.sensors), ("torque from", self.tests)):
            header = ("symbol", "reported", *(f"{kind} {one.name}" for one in group), "unit")
            rows = []
            for name, std in self.std.items():
                stds = (number(2 * one.std[name] if one.std else None, 2) for one in group)
                rows.append((self.symbols[name], number(2 * std, 2), *stds, self.units[name]))
            blocks.append(Table(header, tuple(rows), words=(0, len(header) - 1)))
        return Document(self.sentence, (*blocks, Listing(self.sentences)))


@one_thread()
def advise(
    estimate: Estimate,
    record: Record,
    *,
    encoder_step: float | None = None,
    noise: Noise = "loop",
    pulse: tuple[float, float] | None = None,
    progress: Progress = ignore_progress,
) -> Advice | StiffnessTestDesign:
    """Predict what encoders, pulses or a faster motion would add to an estimate.

    Its intervals with each of them (see the module); where the record does not identify the stiffness, the modes that
    pulses or a load encoder would identify.

    Args:
        estimate: by DIDIM.
        record: that it was identified from.
        encoder_step: of encoders on motor and load, m or rad, on the joint's side of a transmission; None: as fine as
            those of the record, or a millionth of the commanded travel where it has none.
        noise: where the torque's residual comes from, "loop" or "log"; a record does not tell, and a force in the loop
            gives the wider intervals.
        pulse: height (N or N m) and width (s) of the pulses that are tried; None: see `choose_pulse`.
        progress: called with each step.

    Raises:
        MethodError: the estimate is not one of a simulated loop as it was declared, is of another record, or does not
            identify a parameter other than the stiffness.
    """
    predict = design_stiffness_test if estimate.checks.bounds else predict_intervals
    return predict(estimate, record, encoder_step=encoder_step, noise=noise, pulse=pulse, progress=progress)


def predict_intervals(
    estimate: Estimate,
    record: Record,
    *,
    encoder_step: float | None,
    noise: Noise,
    pulse: tuple[float, float] | None,
    progress: Progress,
) -> Advice:
    """Predict the intervals of an estimate with encoders, with pulses and with a faster motion; see `advise`."""
    problem, x = rebuild_declared_problem(estimate, record)
    if len(estimate.params.correlation) < x.size:
        raise MethodError(
            f"A prediction begins at the correlations of all {x.size} free parameters, and this estimate has those of "
            f'{len(estimate.params.correlation)}; identify with statistics = "sensitivities".'
        )
    own = problem.free_joint
    names = [p.name for p in own]
    known = estimate.params.covariance
    reported = {p.name: p.stderr or 0.0 for p in estimate.params.rows if p.name in names}
    work = Work(progress, "predicting other experiments", 4, "parts")
    sensors = []
    steps = choose_encoder_steps(record, encoder_step)
    motor, load = compute_encoder_information(problem, x, noise, *steps)
    unit = POSITION_UNIT[problem.joint.kind]
    encoders = [("motor encoder", f"steps of {steps[0]:.2g} {unit}", motor)]
    if load is not None:
        encoders.append(("load encoder", f"steps of {steps[1]:.2g} {unit}", load))
        encoders.append(("both", f"steps of {steps[0]:.2g} and {steps[1]:.2g} {unit}", motor + load))
    for name, description, information in encoders:
        std = covariance_of(add_information(known, information), 0).std
        sensors.append(Prediction(name, description, dict(zip(names, map(float, std), strict=False))))
    work.add()
    height, width = pulse or choose_pulse(problem, problem.values(x))
    error, J = problem.linearise(x)
    before = stationary(J, J, error).std
    work.add()
    tests = []
    for motion in (add_pulses(problem, height, width), double_acceleration(problem, record)):
        seen = None if problem.seen is None else SeenPosition(motion.experiment)
        measured = problem.measured[: motion.experiment.samples]
        changed = replace(problem, experiment=motion.experiment, measured=measured, seen=seen)
        response, columns = changed.sensitivities(x)
        predicted: dict[str, float] = {}
        if response.outcome is Outcome.FINISHED:
            J = changed.filter(columns)
            after = stationary(J, J, error[: len(J)]).std * math.sqrt(len(J) / error.size)
            changes = dict(zip(names, map(float, after / before), strict=False))
            predicted = {name: std * changes[name] for name, std in reported.items()}
        tests.append(Prediction(motion.name, motion.description, predicted))
        work.add()
    return Advice(
        estimate.data.record,
        noise,
        {p.name: p.symbol for p in own},
        {p.name: problem.units[p.name] for p in own},
        reported,
        tuple(sensors),
        tuple(tests),
        estimate.settings.joint.transmission,
    )


def rebuild_declared_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the problem an estimate solved and its free parameters, 0 for those not identifiable.

    Raises:
        MethodError: it is not of a simulated loop as it was declared, or of another record.
    """
    estimate.require_joint()
    if estimate.settings.loop is None:
        raise MethodError("A prediction needs an estimate by DIDIM, which simulates its loop; this one is by IDIM.")
    another = (
        f"The estimate is of {estimate.data.record}, and {record.name} holds another torque; give the record it is of."
    )
    problem, x = rebuild_problem(estimate, record, another)
    freed = [p.name for p in estimate.params.rows if p.free and not p.of_joint]
    if any(name not in INITIAL for name in freed):
        raise MethodError(
            f"A prediction takes the loop as declared, and here {', '.join(freed)} was free; identify with those fixed."
        )
    return problem, x


@dataclass(frozen=True, slots=True)
class DetectableMode:
    """Highest mode that one test identifies at one load share.

    Attributes:
        share: of the load in the inertia.
        softest: free-free, Hz, of the softest joint the record allows.
        deviation: relative, of that joint's compliance.
        mode: highest identified, Hz, free-free; None if not even the softest is.
    """

    share: float
    softest: float
    deviation: float
    mode: float | None


@dataclass(frozen=True, slots=True, eq=False)
class StiffnessTestDesign:
    """Tests that would identify a stiffness.

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

    @property
    def sentences(self) -> tuple[str, ...]:
        """Its lines."""
        return tuple(str(self).splitlines())

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
    encoder_step: float | None = None,
    noise: Noise = "loop",
    pulse: tuple[float, float] | None = None,
    progress: Progress = ignore_progress,
) -> StiffnessTestDesign:
    """Predict the modes that pulses or a load encoder would identify; see `advise`."""
    problem, _ = rebuild_declared_problem(estimate, record)
    parted = ("motor_", "load_", "stiffness", "damping")  # free, even those that were kept fixed
    problem = problem.replace_parameters(
        {p.name: replace(p, free=True) for p in problem.parameters if p.name.startswith(parted)}
    )
    sample_time, cutoff = problem.experiment.sample_time, problem.filtering.cutoff
    assert cutoff is not None
    band = Filtering(cutoff=max(_BAND / sample_time, cutoff)).resolve(sample_time, "flexible")
    wide = replace(problem, filtering=band)
    error = wide.filter(estimate.fit.measured - estimate.fit.predicted)
    assert estimate.checks.known is not None
    rigid = {p.name: p.value or 0.0 for p in estimate.params.rows if acts_on_whole(p.name) or not p.of_joint}
    rigid = {one.combination.quantity: one.value for one in estimate.checks.known.physical} | rigid
    height, width = pulse or choose_pulse(problem, rigid)
    rung = replace(wide, experiment=add_pulses(problem, height, width).experiment)
    step = choose_encoder_steps(record, encoder_step)[1]

    def deviation(by: ClosedLoopProblem, values: Mapping[str, float], doubt: float, encoder: bool) -> float:
        x = by.vector(values)
        response, columns = by.sensitivities(x)
        if response.outcome is not Outcome.FINISHED:
            return math.inf
        J = by.filter(columns)
        known = doubt**2 * stationary(J, J, error).matrix
        if encoder:
            _, load = compute_encoder_information(by, x, noise, step, step)
            assert load is not None
            known = add_information(known, load)
        at = [p.name for p in by.free].index("stiffness")
        return math.sqrt(max(float(known[at, at]), 0.0)) / values["stiffness"]

    def predict_mode(by: ClosedLoopProblem, bound: StiffnessBound, encoder: bool) -> DetectableMode:
        assert bound.frequency is not None
        softest = pseudo_regular(rigid, bound.frequency, bound.share)
        doubt = max(_EXCLUDED / deviation(wide, softest, 1.0, False), 1.0)

        def deviation_at(mode: float) -> float:
            return deviation(by, pseudo_regular(rigid, mode, bound.share), doubt, encoder)

        return _find_highest_mode(bound.share, bound.frequency, deviation_at, FASTEST / sample_time)

    bounds = [bound for bound in estimate.checks.bounds if bound.share in SHARES and bound.frequency is not None]
    asked = [(by, bound, encoder) for by, encoder in ((rung, False), (wide, True)) for bound in bounds]
    steps = follow(asked, progress, "predicting the highest identified mode", len(asked), "tests")
    modes = tuple(predict_mode(*one) for one in steps)
    return StiffnessTestDesign(
        estimate.data.record,
        modes[: len(bounds)],
        modes[len(bounds) :],
        height, width, step, problem.torque_unit, POSITION_UNIT[problem.joint.kind], problem.joint.transmission,
    )  # fmt: skip


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
