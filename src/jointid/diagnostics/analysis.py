"""Spectra, frequency response and profile intervals of an estimate.

The response is that of the linear part (`models.linear`), moving forwards. A profile follows the criterion where it is
no parabola, as for a stiffness that is barely identifiable.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError, RecordError
from jointid.common.parallel import in_threads
from jointid.common.parameters import POSITION_UNIT
from jointid.estimation.problems.simulated import ClosedLoopProblem, torque_problem
from jointid.estimation.result.estimate import IN_WINDOWS, Estimate, fingerprint
from jointid.models.linear import OUTPUTS, frequency_response
from jointid.records.record import Record, takes_record
from jointid.simulation.controller_torque import compute_controller_torque
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.identifiability import Combination
from jointid.uncertainty.position_dependent_error import uncertainty
from jointid.uncertainty.profile import ProfileInterval, profile, profile_compliance

Profiles: TypeAlias = tuple[ProfileInterval, ...]
"""What `intervals` returns."""

_PARTS = 8  # of the record, each as long as a window of the spectra; windows overlap by half
_LONGEST, _SHORTEST = 8192, 64  # samples of a window: a finer resolution adds nothing for a joint
_LINES, _LOWEST, _ABOVE = 400, 0.1, 3.0  # of the response; Hz; times the fastest of the three frequencies, at least


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyResponse:
    """Frequency response of an identified joint.

    Attributes:
        frequency: (lines,) Hz.
        sides: whose velocity it is: of the motor, and for a flexible joint of the load.
        magnitude: (sides, lines) of the velocity per torque.
        phase: (sides, lines) degrees.
        unit: of the magnitude.
        modes: Hz by name, of a flexible joint; see `FlexibleJoint.frequencies`.
    """

    frequency: FloatArray
    sides: tuple[str, ...]
    magnitude: FloatArray
    phase: FloatArray
    unit: str
    modes: Mapping[str, float]


def estimate_spectra(measured: FloatArray, predicted: FloatArray, sample_time: float) -> tuple[FloatArray, ...]:
    """Frequencies, Hz, and amplitude spectra of measured and predicted signal, and difference.

    These are one-sided amplitude spectral densities, averaged over windows (Welch 1967), (lines,) in the signal's unit
    per square root of Hz.

    Args:
        measured: (samples,).
        predicted: (samples,) at the same instants.
        sample_time: seconds.

    Raises:
        RecordError: the signals are too short for a spectrum, or are not of one length.
    """
    from scipy.signal import welch

    if measured.shape != predicted.shape or measured.size < 2 * _SHORTEST:
        raise RecordError(f"Spectra take {2 * _SHORTEST} samples or more; received {measured.size}: record longer.")
    wanted = min(max(measured.size // _PARTS, _SHORTEST), _LONGEST)
    window = 1 << (wanted.bit_length() - 1)
    signals = np.stack([measured, predicted, measured - predicted])
    frequency, power = welch(signals, 1.0 / sample_time, nperseg=window, detrend="constant")
    return frequency[1:], *np.sqrt(power[:, 1:])  # 0 left out


def compute_response(estimate: Estimate) -> FrequencyResponse:
    """Return the frequency response of an estimate.

    Raises:
        MethodError: a parameter of the joint is not identifiable.
    """
    joint, values, modes = estimate.settings.joint, estimate.require_values(), estimate.frequencies
    highest = max(0.5 / estimate.data.sample_time, _ABOVE * max(modes.values(), default=0.0))
    grid = np.geomspace(_LOWEST, highest, _LINES)
    frequency = np.unique(np.concatenate([grid, [f for f in modes.values() if f > _LOWEST]]))
    sides = ("motor", "load")[: 2 if joint.model == "flexible" else 1]
    outputs = OUTPUTS[1 : 2 * len(sides) : 2]  # the velocities
    found = np.stack([frequency_response(joint, values, frequency, output) for output in outputs])
    phase = np.degrees(np.unwrap(np.angle(found), axis=1))
    torque_unit = f"({own})" if " " in (own := estimate.data.torque_unit) else own
    unit = f"({POSITION_UNIT[joint.kind]}/s)/{torque_unit}"
    return FrequencyResponse(frequency, sides, np.abs(found), phase, unit, modes)


@takes_record
def intervals(estimate: Estimate, record: Record, quantities: Sequence[str] | None = None) -> Profiles:
    """Profiles of an estimate by DIDIM, on its side of the transmission.

    Args:
        estimate: of the record.
        record: it came from.
        quantities: to profile: names of free parameters, "compliance" for 1/K12, or sums and differences of parameters,
            "motor_viscous + load_viscous". None means the stiffness, or the inertia of a rigid joint; where that is
            fixed, the first free parameter.

    Raises:
        MethodError: the estimate is not by DIDIM or lacks a parameter, a quantity is unknown, or the record is
            another one.
    """
    problem, x = rebuild_problem(estimate, record)
    residual, J = problem.linearise(x)
    names = [p.name for p in problem.free]
    spread = uncertainty(Influence(J, residual), problem.cells(problem.simulate(x))).covariance
    asked = list(quantities) if quantities is not None else ["stiffness"] if "stiffness" in names else names[:1]
    if "compliance" in asked and "stiffness" not in names:
        raise MethodError("A compliance is that of a flexible joint whose stiffness is free; this joint has none.")

    def follow(name: str) -> ProfileInterval:
        if name == "compliance":
            return profile_compliance(problem, x, spread, problem.joint.unit)
        return profile(problem, x, _parse_combination(problem, name), spread)

    return tuple(in_threads(follow, asked))


def rebuild_problem(estimate: Estimate, record: Record) -> tuple[ClosedLoopProblem, FloatArray]:
    """Return the closed-loop problem that an estimate solved, and its free parameters.

    Raises:
        MethodError: the estimate is not by DIDIM or lacks a value, or the record is another one.
    """
    settings, data = estimate.settings, estimate.data
    joint, loop, method = settings.joint, settings.loop, settings.method.upper()  # a robot is refused as such
    if loop is None:
        raise MethodError(f"Only DIDIM simulates a loop that can be followed; received an estimate by {method}.")
    estimate.require_values()
    if "motor_position" in data.channels and not record.computed:  # its torque was computed from that
        record = compute_controller_torque(record, loop)
    record.require(("torque",), "The estimate")
    if data.windows or [fingerprint(torque.values) for torque in (record.torque,) if torque] != [*data.fingerprints]:
        other = f"The estimate is from {data.record}, and {record.name} has another torque: give its record."
        raise MethodError(IN_WINDOWS if data.windows else other)
    values = {p.name: p.value or 0.0 for p in estimate.rows}
    problem = torque_problem(record, loop, settings.filtering, joint.parameters)
    problem = problem.freeing(*(name for name in values if name not in problem.units))
    problem = problem.keeping({p.name: values[p.name] for p in estimate.rows if not p.free})
    return problem, problem.vector(values)


def _parse_combination(problem: ClosedLoopProblem, quantity: str) -> Combination:
    """Parse a combination of parameters such as ``a + b - c``."""
    weights = weights_of(quantity)
    free = {p.name: p for p in problem.free}
    units = {problem.units[name] for name in weights.keys() & free.keys()}
    if not weights.keys() <= free.keys() or len(units) > 1:
        raise MethodError(
            f'"{quantity}" is no quantity of this estimate; name a free parameter ({", ".join(free)}), the compliance, '
            "or a sum or difference of parameters in one unit."
        )
    signed = [("- " if weight < 0 else "+ ") + free[name].symbol for name, weight in weights.items()]
    return Combination(quantity, " ".join(signed).removeprefix("+ "), units.pop(), weights)


def weights_of(quantity: str) -> dict[str, float]:
    """Signs by parameter in text such as ``a + b - c``."""
    first, *others = re.split(r"\s([+-])\s", quantity)  # a joint's name may have a hyphen: head-pan
    signed = [("-" if first.strip().startswith("-") else "+", first.strip().removeprefix("-"))]
    signed += zip(others[::2], others[1::2], strict=True)
    return {name.strip(): -1.0 if sign == "-" else 1.0 for sign, name in signed}
