"""The parts of an estimate: its parameters, fit, checks, the data it is from, and the settings it was made with."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Documented
from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT, Quantity, unit_of
from jointid.common.text import interval, number
from jointid.common.transmission import Side, Transmission
from jointid.estimation.result.agreement import Agreement
from jointid.estimation.result.verdict import StiffnessBound, Verdict
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.checks import EncoderLag
from jointid.records.record import Resampled, Timing
from jointid.records.signals.filtering import Filtering
from jointid.solvers.regression import Conditioning
from jointid.uncertainty.covariance import Covariance
from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.model_tests import EndogeneityTest
from jointid.uncertainty.residual_tests import ResidualReport

_TURNED = (
    "offset", "force_drift", "cosine", "_position", "_velocity", "initial_torque", "gravity_constant", "gravity_cos",
    "gravity_sin", "counterbalance_constant", "counterbalance_cos", "counterbalance_sin",
)  # fmt: skip
"""Ends of the names of what changes its sign with the direction; all else is odd in the motion, or a size."""
_EXCHANGED = {"forwards": "backwards", "backwards": "forwards"}


class UnknownName(MethodError, KeyError):  # noqa: N818, it is a name that Python's own KeyError is caught by
    """Unknown parameter name."""

    __str__ = Exception.__str__  # KeyError's own puts the sentence in quotes


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One line of the table.

    Attributes:
        name, symbol, unit: what it is.
        value: the estimate; None when it is refused.
        stderr: its standard error; None for a parameter that was kept fixed, or refused.
        free: whether it was identified.
        lower_bound: what the record supports when the value is refused.
        of_joint: False for what surrounds the joint (the initial state).
        at_bound: the bound that holds it, where it does not follow the record; None where none does.
        lack_of_fit: by how much what the joint has and its model has not may move it, as one deviation; it is the same
            in every record of such a motion, so it is no part of `stderr`.
        axis: the joint of a robot; empty for a single joint.
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    free: bool
    lower_bound: float | None = None
    of_joint: bool = True
    at_bound: float | None = None
    lack_of_fit: float = 0.0
    axis: str = ""

    @property
    def deviation(self) -> float | None:
        """The standard error and the lack of fit together: half of half the interval; None without a standard error."""
        return None if self.stderr is None else math.hypot(self.stderr, self.lack_of_fit)

    @property
    def interval(self) -> tuple[float, float] | None:
        """Lower and upper end of the value with two deviations; None where there is no standard error."""
        deviation = self.deviation
        if self.value is None or deviation is None:
            return None
        return self.value - 2 * deviation, self.value + 2 * deviation


def format_signed(value: float, digits: int = 5) -> str:
    """Format a number with sign and significant digits: +1230, -0.0420."""
    return f"{'-' if value < 0 else '+'}{number(abs(value), digits)}"


def show_value(p: EstimatedParameter) -> str:
    """Format a value with its interval; a refused one by its bound."""
    if p.value is None:
        return "not identifiable" if p.lower_bound is None else f"> {number(p.lower_bound, 3)}"
    if p.at_bound is not None or not p.free:
        return f"{number(p.value)} (fixed)" if p.at_bound is None else f"{number(p.at_bound)} (bound)"
    return number(p.value) if p.deviation is None else interval(p.value, 2 * p.deviation)


@dataclass(frozen=True, slots=True, eq=False)
class Params(Mapping[str, EstimatedParameter]):
    """The parameters of an estimate, by name or symbol: ``params["stiffness"]``, ``params["K12"]``.

    Attributes:
        rows: in the order of the model, then those of what surrounds it; ``name@2`` is the second record's own.
        names: of the free parameters, in the order of `correlation`.
        correlation: of the errors of the free parameters, all of them, or the joint's, which come first; empty where it
            is not known.
    """

    in_json = "correlation -rows"
    rows: tuple[EstimatedParameter, ...]
    names: tuple[str, ...]
    correlation: FloatArray

    def __getitem__(self, name: str) -> EstimatedParameter:
        """Return a parameter by its name or symbol, ``name@2`` the second record's own.

        Raises:
            UnknownName: there is none of this name.
        """
        named = {p.symbol: p for p in self.rows} | {p.name: p for p in self.rows}
        if name not in named:
            raise UnknownName(f'"{name}" is no parameter of this estimate; it has {", ".join(self)}: name one of them.')
        return named[name]

    def __iter__(self) -> Iterator[str]:
        return iter([p.name for p in self.rows])

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def stderr(self) -> FloatArray:
        """Standard errors of the free parameters, (free,), in the order of `names`; NaN of a refused one."""
        return np.array([np.nan if (s := self[name].stderr) is None else s for name in self.names])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the errors of the free parameters as far as their correlation is known, in that order."""
        stderr = self.stderr[: len(self.correlation)]
        return np.asarray(self.correlation * np.outer(stderr, stderr))

    def correlation_of(self, names: Sequence[str]) -> FloatArray:
        """Return the correlation of the errors of some free parameters, (names, names); none where it is not known."""
        at = [self.names.index(name) for name in names]
        known = max(at, default=0) < len(self.correlation)
        return np.asarray(self.correlation[np.ix_(at, at)] if known else np.eye(len(at)))


def on_other_side(
    parameters: Sequence[EstimatedParameter], gear: Transmission, torque_unit: str
) -> tuple[EstimatedParameter, ...]:
    """Return parameters, in a unit of torque, as they are on the other side of a transmission, in the same order."""
    here, found = {p.name: p for p in parameters}, list[EstimatedParameter]()
    for p in parameters:
        name, unit, factor = cross(gear, p.name, p.unit, torque_unit)
        same = here.get(name, p)  # but for the direction
        value, bound = (None if one is None else factor * one + 0.0 for one in (same.value, same.lower_bound))  # no -0
        stderr = None if same.stderr is None else abs(factor) * same.stderr
        own = replace(same, name=p.name, symbol=p.symbol, unit=unit, value=value, stderr=stderr, lower_bound=bound)
        found.append(replace(own, lack_of_fit=abs(factor) * same.lack_of_fit))
    return tuple(found)


def cross(gear: Transmission, name: str, unit: str, torque_unit: str) -> tuple[str, str, float]:
    """Return name, unit and factor of a parameter on the other side, from those on the identified one.

    The motor's ``tau motor = J a + Fv v + Fc sign(v) + offset`` is on the load, with its ratio r::

        tau load = r^2 J a + r^2 Fv v + |r| Fc sign(v) + r offset

    Stiffness and damping scale with r^2, a compliance with its inverse. A negative r exchanges the directions.

    Args:
        gear: a negative ratio exchanges the direction of a parameter.
        name: of the parameter.
        unit: of its value.
        torque_unit: in which the joint's parameters are: N, N m, A or V.
    """
    other: Side = "motor" if gear.side == "load" else "load"
    ratio, kind, factor = gear.position(other), gear.kind_of(other), 1.0
    quantity = next((q for q in Quantity if unit_of(q, gear.kind, torque_unit) == unit), None)
    if quantity is not None:  # quantities of one unit scale alike
        factor = abs(ratio) ** quantity.power
        unit = unit_of(quantity, kind, TORQUE_UNIT[kind] if torque_unit in TORQUE_UNIT.values() else torque_unit)
    if ratio < 0:
        factor = -factor if name.endswith(_TURNED) else factor
        stem, separator, way = name.rpartition("_")
        name = f"{stem}{separator}{_EXCHANGED.get(way, way)}"
    return name, unit, factor


@dataclass(frozen=True, slots=True, eq=False)
class Sums:
    """The parameters of an estimate as sums of a robot's own numbers.

    Attributes:
        values: (parameters,) as they were identified. covariance: of these.
        of_standard: (parameters, 11 n) what inertial parameters, link by link, then rotors add to each.
        of_others: (parameters, others) what all else adds: friction, offsets, springs.
        others: (others,) about what these are. least: (others,) below which none of them is.
        robot: makes a robot of inertial parameters, (n, 10), rotors, (n,), and the others.
    """

    values: FloatArray
    covariance: Covariance
    of_standard: FloatArray
    of_others: FloatArray
    others: FloatArray
    least: FloatArray
    robot: Callable[[FloatArray, FloatArray, FloatArray], Robot]


# The other parts


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """How well the model reproduces the torque, and what it took to find out.

    Attributes:
        measured, predicted: (samples,) raw torque, and that of the model; of several records one after the other; empty
            for a log that is too long for memory; of a robot (samples, n), in the order of its joints.
        borders: samples left out at each end of the raw error.
        relative_error: ``||measured - predicted|| / ||measured||`` of the raw torque, borders left out; a ratio.
        filtered_error: the same of the filtered and decimated torque: what was minimised.
        rows: filtered samples that were fitted.
        residuals: tests of the filtered error: whiteness, repetition with the motion.
        conditioning: of the regressor, for a linear regression.
        simulations: that were run, all of them, those for derivatives and deviations included.
        passes: over the whole of a long log.
        stop: why the search ended, in a sentence; converged: whether that is a good end.
        axis_errors: the filtered error of each joint of a robot, by name; its rms is then `filtered_error`.
        position_rms: of the simulated motor position's error where it was logged under a controller, in m or rad, by
            the name of the joint in its robot, "" for a joint alone.
    """

    measured: FloatArray
    predicted: FloatArray
    borders: tuple[int, int]
    relative_error: float
    filtered_error: float
    rows: int
    simulations: int
    stop: str
    converged: bool
    residuals: ResidualReport | None = None
    conditioning: Conditioning | None = None
    passes: int = 0
    axis_errors: Mapping[str, float] = field(default_factory=dict)
    position_rms: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """The checks of an estimate.

    Attributes:
        verdicts: on the solver, the fit, the residual, identifiability, bounds, stiffness; one question each.
        known: which parameters and combinations the record determines, and how well.
        tests: of the method's assumptions.
        bounds: lower bounds of a refused stiffness, by the load's share of the inertia.
        agreement: whether several records, each by itself, agree; drift: whether the segments of a long log do.
        encoder_lag: that hides the spring between both encoders, where they were read.
        diagnosis: of loop, log and residual, axis by axis, a `Diagnosis`; None where it was not made.
        warnings: one sentence each.
        notes: on how the intervals were obtained, one sentence each.
    """

    in_json = "-diagnosis"
    verdicts: tuple[Verdict, ...] = ()
    known: Identifiability | None = None
    tests: tuple[EndogeneityTest, ...] = ()
    bounds: tuple[StiffnessBound, ...] = ()
    agreement: Agreement | None = None
    drift: Agreement | None = None
    encoder_lag: EncoderLag | None = None
    diagnosis: Documented | None = None
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class RecordFit:
    """One of several records: what it says by itself, and how well the common model reproduces it.

    Attributes:
        name: of the record; fingerprint: of its torque.
        channels: that were read.
        added_inertia: known, on the load, on top of what is shared.
        alone: estimated from this record by itself: all that is free in it, in the units of the answer, without
            the added inertia, so that records can be compared.
        level: the residual that remains of it by itself, rms over its degrees of freedom: its rows are weighted by
            the inverse.
        rows: of its filtered torque.
        relative_error, filtered_error: norm of the error of the common model over that of the torque, raw with the
            borders left out, and filtered.
    """

    name: str
    fingerprint: str
    channels: tuple[str, ...]
    added_inertia: float
    alone: tuple[EstimatedParameter, ...]
    level: float
    rows: int
    relative_error: float
    filtered_error: float


@dataclass(frozen=True, slots=True)
class Windows:
    """The windows in which a long log was identified.

    Attributes:
        count: that were fitted; still: in which nothing was asked of the axis, and which were left out.
        length: seconds of each. settling: seconds simulated before and after each window, and not fitted.
        duration: seconds from the first to the last fitted row.
    """

    count: int
    still: int
    length: float
    settling: float
    duration: float


IN_WINDOWS = (
    "The estimate is of a record in windows, whose torque it does not keep; identify a part of the record, by "
    "record.start and record.stop."
)
"""What needs the torque of the whole record says so."""


@dataclass(frozen=True, slots=True, eq=False)
class Data:
    """The record, or records, that were identified from.

    Attributes:
        record: its name; of several, all names.
        channels: that were read.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V.
        fingerprint: of the torque, see `fingerprint`.
        logs: of the torques of each log of a robot.
        resampled: how the samples were brought to a uniform clock, None where they were logged so.
        records: each of several records by itself; empty for one record.
        windows: how a long log was cut; None for a record.
    """

    record: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    fingerprint: str = ""
    logs: tuple[str, ...] = ()
    resampled: Resampled | None = None
    records: tuple[RecordFit, ...] = ()
    windows: Windows | None = None

    @property
    def fingerprints(self) -> tuple[str, ...]:
        """Fingerprints of all records, or of all logs of a robot."""
        return self.logs or tuple(one.fingerprint for one in self.records) or (self.fingerprint,)


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """The model and the method, defaults filled in.

    Attributes:
        method: its name, as in a joint file; variant: how it was run, in words.
        system: the model, a joint or a robot. loop: the closed loop of a joint, when the method simulated one.
        filtering: as used.
        delay: seconds from the logged torque to the torque that acts, as declared, or as found where it was free.
        timing: reading of a torque of unstated timing; None where it was stated, or nothing else tried.
        controller: of an estimate from a file the fingerprint of the law that it was identified under.
    """

    in_json = "-loop -controller"
    method: str
    variant: str
    system: Joint | Robot
    loop: ClosedLoop | None
    filtering: Filtering
    delay: float = 0.0
    timing: Timing | None = None
    controller: str = ""

    @property
    def joint(self) -> Joint:
        """The model of a joint.

        Raises:
            MethodError: the estimate is of a robot.
        """
        if isinstance(self.system, Robot):
            raise MethodError("This needs the estimate of one joint, and received that of a robot; identify the joint.")
        return self.system
