"""Predict the intervals of an estimate with other sensors or another motion, before either is paid for.

`advise` takes an estimate and its record. Covariances are predicted from exact sensitivities at the estimate, and
begin at those that were reported: what is predicted is how much they change.

- A sensor adds its information to the torque's (`sensor_information`).
- A motion is simulated at the estimate and gives other sensitivities J. The residual is taken to keep the spectrum it
  has in the record, and the covariance of least squares under it (`uncertainty.covariance.stationary`) is set against
  the same for the record's own motion. A loop that sees the same disturbance does keep it; friction that repeats with
  the motion would change.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Block, Document, Documented, Facts, Listing, Paragraph, Table, common_facts
from jointid.common.errors import MethodError
from jointid.common.progress import Progress, silent
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.diagnostics.sensor_information import (
    Noise,
    add_information,
    assume_encoder_step,
    compute_encoder_information,
)
from jointid.diagnostics.variations import Variation, add_pulses, choose_pulse, double_acceleration
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE, INITIAL_TORQUE
from jointid.estimation.result.estimate import Estimate, fingerprint
from jointid.models.parameters import POSITION_UNIT
from jointid.records.record import Record, Tap
from jointid.records.signals.encoder import find_encoder_step
from jointid.simulation.closed_loop import Outcome
from jointid.uncertainty.covariance import covariance_of, stationary

_WORTH = 0.8  # of a deviation: a smaller gain is not worth a sentence


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

    def ratio(self, change: str, name: str) -> float:
        """Return the predicted deviation of a parameter under a change, over the reported one.

        Raises:
            KeyError: there is no such change, or parameter.
        """
        found = {one.name: one for one in (*self.sensors, *self.tests)}[change]
        return found.std[name] / self.std[name]

    @property
    def sentences(self) -> tuple[str, ...]:
        """The interval that each change narrows most, a sentence each."""
        return tuple(self._sentence(one) for one in (*self.sensors, *self.tests))

    def _sentence(self, change: Prediction) -> str:
        if not change.std:
            return f"{change.name}: {change.description}; the loop cannot be simulated with it"
        name = min(change.std, key=lambda n: change.std[n] / self.std[n])
        before, after = self.std[name], change.std[name]
        if after > _WORTH * before:
            return f"{change.name}: {change.description}; narrows no interval by more than a fifth"
        return (
            f"{change.name}: {change.description}; narrows {self.symbols[name]} most, from +- {number(2 * before, 2)} "
            f"to +- {number(2 * after, 2)} {self.units[name]}"
        )

    def document(self, *, details: bool = False) -> Document:
        """Return a table for sensors, one for tests, and a sentence each; there are no further details."""
        del details
        where = {
            "loop": "caused by a force inside the loop, the log being the controller's output",
            "log": "measurement noise of the log",
        }[self.noise]
        facts = common_facts(None, self.transmission)
        blocks: list[Block] = [Paragraph(f"the torque residual is taken to be {where}")]
        blocks += [Facts(facts)] if facts else []
        for kind, group in (("torque and", self.sensors), ("torque from", self.tests)):
            header = ("symbol", "reported", *(f"{kind} {one.name}" for one in group), "unit")
            rows = tuple(self._row(name, group) for name in self.std)
            blocks.append(Table(header, rows, words=(0, len(header) - 1)))
        title = f"Predicted 2-sigma intervals of {self.record} with other sensors or motions"
        return Document(title, (*blocks, Listing(self.sentences)))

    def _row(self, name: str, group: tuple[Prediction, ...]) -> tuple[str, ...]:
        stds = (number(2 * one.std[name] if one.std else None, 2) for one in group)
        return self.symbols[name], number(2 * self.std[name], 2), *stds, self.units[name]


def advise(
    estimate: Estimate,
    record: Record,
    *,
    encoder_step: float | None = None,
    noise: Noise | None = None,
    pulse: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> Advice:
    """Predict the intervals of an estimate with encoders, with pulses and with a faster motion (see the module).

    Args:
        estimate: by DIDIM, all parameters identifiable.
        record: that it was identified from.
        encoder_step: of encoders on motor and load, m or rad, on the joint's side of a transmission; None: as fine as
            those of the record, or a millionth of the commanded travel where it has none.
        noise: where the torque's residual comes from, "loop" or "log"; None: by the record's tap, "log" for a measured
            torque.
        pulse: height (N or N m) and width (s) of the pulses that are tried; None: see `variations.pulse_of`.
        progress: called with each step.

    Raises:
        MethodError: the estimate is not one of a simulated loop as it was declared, has a parameter that is not
            identifiable, or is of another record.
    """
    problem, x = rebuild_declared_problem(estimate, record)
    if estimate.checks.bounds:
        raise MethodError(
            "The stiffness is not identifiable from this record, so no intervals can be predicted; "
            "design_stiffness_test predicts which test would identify it."
        )
    noise = noise or find_noise_source(record)
    scale = np.array([p.stderr or 0.0 for p in estimate.params if p.free])
    known = estimate.params.correlation * np.outer(scale, scale)
    progress("simulating the loop for its positions")
    sensors = _predict_sensors(problem, x, noise, choose_encoder_steps(record, encoder_step), known)
    progress("simulating other motions")
    height, width = pulse or choose_pulse(problem, problem.values(x))
    tests = _predict_motions(
        problem, x, scale, (add_pulses(problem, height, width), double_acceleration(problem, record))
    )
    own = problem.free_joint
    names = [p.name for p in own]
    return Advice(
        estimate.data.record,
        noise,
        {p.name: p.symbol for p in own},
        {p.name: problem.units[p.name] for p in own},
        dict(zip(names, map(float, scale), strict=False)),
        sensors,
        tests,
        estimate.settings.joint.transmission,
    )


def rebuild_declared_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the problem an estimate solved and its free parameters, 0 for those not identifiable.

    Raises:
        MethodError: it is not of a simulated loop as it was declared, or of another record.
    """
    if estimate.settings.loop is None:
        raise MethodError("A prediction needs an estimate by DIDIM, which simulates its loop; this one is by IDIM.")
    assert record.torque is not None
    if fingerprint(record.torque.values) != estimate.data.fingerprint:
        raise MethodError(
            f"The estimate is of {estimate.data.record}, and {record.name} holds another torque; "
            "give the record it is of."
        )
    freed = [p.name for p in estimate.params if p.free and not p.of_joint]
    of_start = {p.name: p for p in (*INITIAL_STATE, INITIAL_TORQUE)}
    if any(name not in of_start for name in freed):
        raise MethodError(
            f"A prediction takes the loop as declared, and here {', '.join(freed)} was free; identify with those fixed."
        )
    found = {p.name: p for p in estimate.params}
    parameters = tuple(
        p if found[p.name].free else p.fixed(found[p.name].value or 0.0)
        for p in (*estimate.settings.joint.parameters, *(of_start[name] for name in found if name in of_start))
    )
    own = len(estimate.settings.joint.parameters)
    problem = torque_problem(
        record, estimate.settings.loop, estimate.settings.filtering, parameters[:own], parameters[own:]
    )
    return problem, problem.vector({name: p.value or 0.0 for name, p in found.items()})


def find_noise_source(record: Record) -> Noise:
    """Return the source of the torque residual implied by the tap of the record."""
    return "log" if record.tap is Tap.MEASURED else "loop"


def choose_encoder_steps(record: Record, given: float | None) -> tuple[float, float]:
    """Return the encoder steps of motor and load: as given, else those of the record, else the assumed ones."""
    if given is not None:
        if not (math.isfinite(given) and given > 0):
            raise MethodError(f"The step of an encoder is a positive number; received {given}.")
        return given, given
    assert record.reference is not None
    motor = find_encoder_step(record.motor_position) or assume_encoder_step(record.reference.values)
    return motor, find_encoder_step(record.load_position) or motor


def _predict_sensors(
    problem: ClosedLoopProblem, x: FloatArray, noise: Noise, step: tuple[float, float], known: FloatArray
) -> tuple[Prediction, ...]:
    """Return the predictions for a motor encoder, a load encoder and both."""
    added = compute_encoder_information(problem, x, noise, *step)
    unit = POSITION_UNIT[problem.loop.joint.kind]
    motor = ("motor encoder", f"steps of {step[0]:.2g} {unit}", added.motor)
    sets = [motor]
    if added.load is not None:
        sets.append(("load encoder", f"steps of {step[1]:.2g} {unit}", added.load))
        sets.append(("both", f"steps of {step[0]:.2g} and {step[1]:.2g} {unit}", added.motor + added.load))
    names = [p.name for p in problem.free_joint]

    def predict(information: FloatArray) -> dict[str, float]:
        std = covariance_of(add_information(known, information), 0).std
        return dict(zip(names, map(float, std), strict=False))

    return tuple(Prediction(name, said, predict(information)) for name, said, information in sets)


def _predict_motions(
    problem: ClosedLoopProblem, x: FloatArray, scale: FloatArray, variations: tuple[Variation, ...]
) -> tuple[Prediction, ...]:
    """Return the predictions for other motions, of the record's duration."""
    error, J = problem.linearised(x)
    own = stationary(J, J, error).std
    names = [p.name for p in problem.free_joint]

    def predict(variation: Variation) -> dict[str, float]:
        changed = replace(problem, experiment=variation.experiment, measured=problem.measured[: variation.samples])
        response, columns = changed.sensitivities(x)
        if response.outcome is not Outcome.FINISHED:
            return {}
        J = changed.filtered(columns)
        left = error[: len(J)]
        std = stationary(J, J, left).std * math.sqrt(len(J) / error.size)
        return dict(zip(names, map(float, scale * std / own), strict=False))

    return tuple(Prediction(one.name, one.description, predict(one)) for one in variations)
