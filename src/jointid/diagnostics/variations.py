"""Other motions than a record's under the same loop, for the prediction of tests."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.parameters import TORQUE_UNIT
from jointid.records.record import Channel, Injection, Record
from jointid.records.signals.excitation import pulses
from jointid.simulation.loop_input import LoopInput, prepare

_COULOMB = 5.0  # times the Coulomb friction of the whole joint: the height of a pulse
_WIDTH = 1.2  # over the cut-off: 20 ms at 60 Hz, half a period of a mode in the middle of the band
_EVERY = 20.0  # widths from one pulse to the next
_FASTER = math.sqrt(2.0)  # times the speed: twice the acceleration


@dataclass(frozen=True, slots=True, eq=False)
class Variation:
    """Another motion under the same loop.

    Attributes:
        name, description: in a word or two, and with its numbers.
        experiment: to simulate.
        samples: of its log.
    """

    name: str
    description: str
    experiment: LoopInput
    samples: int


def choose_pulse(problem: ClosedLoopProblem, values: Mapping[str, float]) -> tuple[float, float]:
    """Return the height (N or N m) and the width (s) of pulses that excite a joint.

    Five times its Coulomb friction, so that they move it from rest, and 1.2 over the cut-off long, as the twin's 20 ms
    are: half a period of a mode in the middle of the fitted band.
    """
    assert problem.filtering.cutoff is not None
    by_direction = {False: 0.0, True: 0.0}
    for name, value in values.items():
        if "coulomb" in name:
            by_direction[name.endswith("backwards")] += abs(value)
    size = max(by_direction.values()) or float(np.sqrt(np.mean(problem.measured**2)))
    return _COULOMB * size, _WIDTH / problem.filtering.cutoff


def add_pulses(problem: ClosedLoopProblem, height: float, width: float) -> Variation:
    """Return the record's own motion with pulses added to the motor's force and to any injected signal.

    Args:
        problem: of the record.
        height: of the pulses, N or N m.
        width: of a pulse, s; one comes every 20 widths, as `excitation.pulses` draws them.
    """
    experiment = problem.experiment
    period = experiment.law.period
    more = pulses(experiment.after_limit.size, period, height, width, _EVERY * width, seed=0)
    unit = problem.loop.joint.torque_unit or TORQUE_UNIT[problem.loop.joint.kind]
    again = "more " if experiment.injected else ""
    description = f"{again}pulses of {height:.2g} {unit} and {1e3 * width:.3g} ms, one in {_EVERY * width:.2g} s"
    changed = replace(experiment, after_limit=experiment.after_limit + more)
    return Variation(f"{again}pulses", description, changed, experiment.samples)


def double_acceleration(problem: ClosedLoopProblem, record: Record) -> Variation:
    """Return the same path with twice the acceleration, repeated for the duration of the record.

    It is simulated once, 1.4 times as fast, for less time; known pulses stay as long and as far apart as they were.
    """
    assert record.reference is not None
    log = record.torque or record.reference
    samples = math.floor(len(log) / _FASTER)

    def speed_up(channel: Channel | None, gain: float = 1.0) -> Channel | None:
        if channel is None:
            return None
        count = math.floor(samples * log.sample_time / channel.sample_time)
        at = np.minimum(_FASTER * np.arange(count), len(channel) - 1)
        return replace(channel, values=gain * np.interp(at, np.arange(len(channel)), channel.values))

    def shorten(channel: Channel) -> Channel:
        return replace(channel, values=channel.values[: math.floor(samples * log.sample_time / channel.sample_time)])

    driven = Record(
        torque=None if record.torque is None else shorten(record.torque),
        tap=record.tap,
        reference=speed_up(record.reference),
        reference_velocity=speed_up(record.reference_velocity, _FASTER),
        injected=None
        if record.injected is None
        else Injection(shorten(record.injected.channel), record.injected.at, record.injected.in_torque),
        name=record.name,
    )
    experiment = prepare(problem.loop, driven)
    return Variation("faster", "the same path with twice the acceleration", experiment, experiment.samples)
