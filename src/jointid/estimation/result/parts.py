"""The parts of an estimate: its rows, how well it fits, the data it is from, and the settings it was made with."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.text import interval, number
from jointid.models.joints import ClosedLoop, Joint
from jointid.models.robots.robot import Robot
from jointid.records.record import Resampled, Timing
from jointid.records.signals.filtering import Filtering
from jointid.solvers.regression import Conditioning


@dataclass(frozen=True, slots=True)
class EstimatedParameter:
    """One row of the table.

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
        axis: the joint of a robot; empty for a single joint, and for what is of all axes.
        formula: of a robot the sum of its own numbers that this is; the symbol where it is no sum. Empty for a joint.
        nominal: of the robot as it was given; None for a joint.
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
    formula: str = ""
    nominal: float | None = None

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
class Fit:
    """How well the model reproduces the torque, and what it took to find out.

    Attributes:
        measured, predicted: (samples,) raw torque, and that of the model; of several records one after the other; empty
            for a log that is too long for memory; of a robot (samples, n), in the order of its joints.
        relative_error: ``||measured - predicted|| / ||measured||`` of the raw torque, the filter's borders left out.
        filtered_error: the same of the filtered and decimated torque: what was minimised.
        rows: filtered samples that were fitted.
        simulations: that were run, all of them, those for derivatives and deviations included.
        stop: why the search ended, in a sentence; converged: whether that is a good end.
        conditioning: of the regressor, for a linear regression.
        passes: over the whole of a long log.
        axis_errors: the filtered error of each joint of a robot, by name; its rms is then `filtered_error`.
        nominal_errors: the same of the nominal robot, with friction as identified or fitted beside it; infinite where
            it cannot be simulated.
    """

    measured: FloatArray
    predicted: FloatArray
    relative_error: float
    filtered_error: float
    rows: int
    simulations: int
    stop: str
    converged: bool
    conditioning: Conditioning | None = None
    passes: int = 0
    axis_errors: Mapping[str, float] = field(default_factory=dict)
    nominal_errors: Mapping[str, float] = field(default_factory=dict)


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
        fingerprints: of the torque of each record, or of each log of a robot, see `fingerprint`; none of a long log.
        resampled: how the samples were brought to a uniform clock, None where they were logged so.
        windows: how a long log was cut; None for a record.
    """

    record: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    fingerprints: tuple[str, ...] = ()
    resampled: Resampled | None = None
    windows: Windows | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """The model and the method, defaults filled in.

    Attributes:
        method: its name, as in a joint file; variant: how it was run, in words.
        system: the model, a joint or a robot. loop: the closed loop of a joint, when the method simulated one.
        filtering: as used.
        delay: seconds from the logged torque to the torque that acts, as declared, or as found where it was free.
        log_delay: of a robot along its motion, seconds by which the log shows torques late; None elsewhere.
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
    log_delay: float | None = None
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
