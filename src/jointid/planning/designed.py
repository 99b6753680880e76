"""A designed test of one or several axes: what it tells, what it reaches, and its files."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import LOAD, MEASURED, SIMULATED, mark, panels, styled
from jointid.common.document import Document, Documented, Facts, Paragraph, Table, common_facts
from jointid.common.files import write_folder
from jointid.common.text import in_words, join, number
from jointid.common.transmission import Side, Transmission
from jointid.models.limits import AxisLimits, describe_excess, units_of_limits
from jointid.planning.goals import Goal
from jointid.planning.predict import PredictedTest
from jointid.planning.trajectories import Trajectory
from jointid.records.record import InjectionPoint, Record, instants
from jointid.records.writing import write_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINE = 0.45
_KNOWN = 0.1  # of a value, that its deviation is less than
_QUANTITIES = ("stroke", "speed", "acceleration", "jerk", "torque", "rms_torque", "windup")


@dataclass(frozen=True, slots=True, eq=False)
class DesignedAxis:
    """One axis of a designed test.

    Attributes:
        name: of a robot's joint; empty of a joint alone.
        test: as a record without a torque yet.
        torque: (samples,) that is predicted.
        sample_time: of the torque, s.
        position_unit, torque_unit: of all numbers.
        transmission: on whose `side` they are.
        limits: that the test keeps.
        from_record: names of the limits that are those of the present test.
        reached: the largest of each quantity, over the joints of the interval.
        present_passes: clauses on limits that the present test passes.
        modes: Hz, as they are roughly known, by name; none of a rigid joint.
    """

    in_json = "passed -test"
    name: str
    test: Record
    torque: FloatArray
    sample_time: float
    position_unit: str
    torque_unit: str
    transmission: Transmission | None
    limits: AxisLimits
    from_record: tuple[str, ...]
    reached: Mapping[str, float]
    present_passes: tuple[str, ...]
    modes: Mapping[str, float]

    @property
    def passed(self) -> tuple[str, ...]:
        """Clauses on limits that are passed; none as a rule."""
        return tuple(describe_excess(self.limits, self.reached, self.units, self.name))

    @property
    def units(self) -> dict[str, str]:
        """Units of the limited quantities."""
        return units_of_limits(self.position_unit, self.torque_unit)

    def word(self, quantity: str) -> str:
        """Return a quantity with the axis's name before it, where it has one."""
        return f"{self.name} {quantity}".strip()

    def cell(self, quantity: str) -> str:
        """Return the reached share of a limit."""
        if quantity == "positions":
            return f"{number(self.reached['lower'], 3)} to {number(self.reached['upper'], 3)} {self.position_unit}"
        if quantity not in self.reached:
            return "-"
        allowed = self.limits.given.get(quantity)
        of = "" if allowed is None else f" of {number(allowed, 3)}"
        return f"{number(self.reached[quantity], 3)}{of} {self.units[quantity]}"


@dataclass(frozen=True, slots=True)
class PlayedAxis:
    """How a file that drives play says one axis; by default in the joint's own units.

    Attributes:
        position, torque: factors from the joint's numbers to the file's.
        position_unit, torque_unit: of the file, where they are others.
        position_side, side: of the transmission that positions and torques are of; None without one.
        injected: column of an added signal, where the file has one.
    """

    position: float = 1.0
    torque: float = 1.0
    position_unit: str = ""
    torque_unit: str = ""
    position_side: Side | None = None
    side: Side | None = None
    injected: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A file that drives play: how each axis is said, the columns by their names, and options of its text."""

    axes: tuple[PlayedAxis, ...]
    columns: Mapping[str, FloatArray]
    options: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class Design(Documented):
    """A proposed test of a joint or a robot, and its predicted intervals.

    Attributes:
        source: record of what is roughly known; empty where it was stated.
        goal: what the test is to tell.
        description: of the test, in words.
        axes: what it does to each axis.
        tests: predictions by the name of the test: "proposed", and where they are known "present", the test there is
            already, "at worst" over what may be known wrong, "with motor encoder" where that tells something new,
            "with load encoder" of a flexible joint, and "twice the time".
        noise: what disturbs the tests, in words.
        assumed: whether that is a guess.
        floor: standard deviation of the goal below which no motion comes; None where it is not known.
        tried: tests of the search.
        interrupted: whether the search was, before its time was over.
        notes: clauses on what is doubtful; none as a rule.
        layout: of the file that drives play; None for SI units on the joint's side.
        from_shafts: (n, n) the joints' positions from the references of their motors; None where they are the same.
    """

    in_json = "sentence passed peaks modes -layout"
    source: str
    goal: Goal
    description: str
    axes: tuple[DesignedAxis, ...]
    tests: Mapping[str, PredictedTest]
    noise: str
    floor: float | None = None
    tried: int = 0
    interrupted: bool = False
    notes: tuple[str, ...] = ()
    layout: Layout | None = None
    assumed: bool = False
    from_shafts: FloatArray | None = None

    @property
    def proposed(self) -> PredictedTest:
        """Prediction of the new test."""
        return self.tests["proposed"]

    @property
    def present(self) -> PredictedTest | None:
        """Prediction of the test there is already; None without one, or if it does not tell every parameter."""
        return self.tests.get("present")

    @property
    def passed(self) -> tuple[str, ...]:
        """Clauses on limits that are passed; none as a rule."""
        return (*self.notes, *(clause for axis in self.axes for clause in axis.passed))

    @property
    def modes(self) -> dict[str, float]:
        """Frequencies of the modes, Hz, by name."""
        return {axis.word(name): hertz for axis in self.axes for name, hertz in axis.modes.items()}

    @property
    def peaks(self) -> tuple[str, ...]:
        """Largest torque of each axis, first as the file of the test says it."""
        found = []
        for k, axis in enumerate(self.axes):
            size, own = axis.reached["torque"], f"{number(axis.reached['torque'], 3)} {axis.torque_unit}"
            if self.layout is not None:
                played = self.layout.axes[k]
                stated = f"{number(size * played.torque, 3)} {played.torque_unit}"
                side = f" of the {played.side}" if played.side else ""
                own = stated + side if stated == own else f"{stated}{side} ({own})"
            found.append(axis.word(own))
        return tuple(found)

    @property
    def sentence(self) -> str:
        """Peak torque as it is played, and the predicted interval of the goal beside that of the present test."""
        over = f" Beware: {'; '.join(self.passed)}." if self.passed else ""
        guess = f", if the noise is {self.noise}" if self.assumed else ""
        return f"Peak torque {'; '.join(self.peaks)}. {self._summary}{guess}.{over}"

    @property
    def _summary(self) -> str:
        present = self.present
        gain = None if present is None else self._score(self.proposed) - self._score(present)
        over = "; ".join(clause for axis in self.axes for clause in axis.present_passes)
        if over:
            first = f"Of the present test: {over}. The best test found within the limits"
        else:
            better = gain is None or not gain >= 0
            first = "The proposed test" if better else "No better test than the present one was found: the best one"
        if self.goal.weights:
            unit = self.proposed.units[next(iter(self.goal.weights))]
            if (worst := self.tests.get("at worst")) is not None:
                unit += f", {self._width(worst)} {unit} at worst"
            stated = f"{first} tells {self.goal.name.replace('_', ' ')} to {self._width(self.proposed)} {unit}"
            return stated if present is None else f"{stated}, the present one to {self._width(present)} {unit}"
        proposed = self.proposed
        well_known = [n for n, std in proposed.std.items() if std < _KNOWN * abs(proposed.values[n])]
        stated = f"{first} tells {len(well_known)} of {len(proposed.joint)} parameters to a tenth"
        if gain is None:
            return stated
        if not math.isfinite(gain):
            return f"{stated}; the present one does not tell all"
        width = f"{number(100 * math.exp(gain), 3)} % of the width of the present one"
        return f"{stated}, and brings intervals on the geometric mean to {width}"

    def _width(self, prediction: PredictedTest) -> str:
        std = prediction.std_of(self.goal.weights)
        return f"± {number(2 * std, 2)}" if math.isfinite(std) else "no bound"

    def _score(self, prediction: PredictedTest) -> float:
        return self.goal.score(prediction.covariance.matrix, prediction.joint, prediction.values)

    def to_document(self, *, details: bool = False) -> Document:
        """Intervals side by side, the test, and its maxima."""
        del details
        tests, proposed = self.tests, self.proposed
        rows = []
        for name in proposed.joint:
            stds = (_sigma(prediction.std[name]) for prediction in tests.values())
            about, unit = number(proposed.values[name], 4), proposed.units[name]
            rows.append((in_words(name), about, *stds, unit, proposed.symbols[name]))
        # Torque alone hardly separates the parameters of both sides.
        for motor, load in self._sides():
            for sign in (1.0, -1.0):
                shown = f"{proposed.symbols[motor]} {'+' if sign > 0 else '-'} {proposed.symbols[load]}"
                value = proposed.values[motor] + sign * proposed.values[load]
                stds = (_sigma(prediction.std_of({motor: 1.0, load: sign})) for prediction in tests.values())
                said = f"{'sum' if sign > 0 else 'difference'} of {in_words(motor.removeprefix('motor_'))}"
                rows.append((said, number(value, 4), *stds, proposed.units[motor], shown))
        header = ("parameter", "about", *tests, "unit", "symbol")
        reached = [
            (name.replace("_", " "), *(axis.cell(name) for axis in self.axes))
            for name in ("positions", *_QUANTITIES)
            if any(name in ("positions", *axis.reached) for axis in self.axes)
        ]
        facts = [("test", self.description), ("noise", self.noise)]
        facts += [fact for axis in self.axes for fact in common_facts(None, axis.transmission)]
        if taken := [axis.word(name.replace("_", " ")) for axis in self.axes for name in axis.from_record]:
            facts.append(("limits", f"not stated, and those which the present test reaches: {join(taken)}"))
        if self.floor is not None and self.goal.weights:
            unit = proposed.units[next(iter(self.goal.weights))]
            facts.append(("floor", f"no motion within these limits comes below ± {number(2 * self.floor, 2)} {unit}"))
        if self.modes:
            facts.append(("modes", ", ".join(f"{name} {number(hertz, 3)} Hz" for name, hertz in self.modes.items())))
        cut = "interrupted; this is the best that was found until then" if self.interrupted else ""
        tried = f"{self.tried} better tests were found" if self.tried else "none: one test was predicted"
        facts.append(("search", cut or tried))
        return Document(
            self.sentence,
            (
                Table(header, tuple(rows), caption="predicted 2 sigma of", words=(0, len(header) - 2, len(header) - 1)),
                Table(
                    ("", *(axis.name or "reached" for axis in self.axes)), tuple(reached),
                    "what the test reaches, of what is allowed", tuple(range(len(self.axes) + 1)),
                ),
                Paragraph("Neither obstacles nor the machine's own body are known here: play the test slowly first."),
                Facts(tuple(facts)),
            ),
        )  # fmt: skip

    def _sides(self) -> list[tuple[str, str]]:
        """Pairs of the parameters of motor and load of one kind, inertias aside."""
        names = self.proposed.joint
        pairs = [(name, f"load_{name[6:]}") for name in names if name.startswith("motor_") and "inertia" not in name]
        pairs += [(name, name.replace(".", ".link_", 1)) for name in names if "." in name]
        return [pair for pair in pairs if pair[1] in names]

    @styled
    def plot(self) -> Figure:
        """Draw reference and predicted torque of each axis, and the spectra of the torques beside the modes."""
        figure, drawn = panels([170] * (3 * len(self.axes)), title="the proposed test")
        for k, axis in enumerate(self.axes):
            position, force, frequency = drawn[3 * k : 3 * k + 3]
            torque, T, shown = axis.torque, axis.sample_time, f"{axis.name}, " if axis.name else ""
            reference = axis.test.reference
            assert reference is not None
            position.plot(reference.time, reference.values, color=MEASURED)
            position.set(xlabel="time [s]", ylabel=f"{shown}reference [{axis.position_unit}]")
            force.plot(instants(torque.size, T), torque, color=SIMULATED, label="torque", linewidth=_LINE)
            if axis.test.injected is not None:
                added = axis.test.injected.channel
                force.plot(added.time, added.values, color=LOAD, label="of it injected", linewidth=_LINE)
            force.set(xlabel="time [s]", ylabel=f"{shown}torque [{axis.torque_unit}]")
            for timed in (position, force):
                if timed is not drawn[0]:
                    timed.sharex(drawn[0])
            hertz = np.asarray(np.fft.rfftfreq(torque.size, T)[1:], dtype=np.float64)
            size = np.abs(np.fft.rfft(torque - torque.mean()))[1:] * 2 / torque.size
            kept = hertz <= 4 * max([*axis.modes.values(), 25.0])
            frequency.plot(hertz[kept], size[kept], color=SIMULATED, linewidth=_LINE)
            for row, (name, mode) in enumerate(axis.modes.items()):
                mark(frequency, mode, name.replace("_", " "), row)
            frequency.set(xlabel="frequency [Hz]", ylabel=f"{shown}torque [{axis.torque_unit}]")
        return figure

    def records(self) -> tuple[Record, ...]:
        """Return the test as a record of each axis, with its reference and what is added to its torque."""
        return tuple(
            replace(axis.test, name="test", torque=None, motor_position=None, load_position=None) for axis in self.axes
        )

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the table and instructions into a folder; return the paths."""
        return write_folder(folder, self.files())

    def files(self) -> dict[str, bytes]:
        """Files of `write`, by name."""
        layout = self.layout or Layout((PlayedAxis(),) * len(self.axes), _columns(self.axes, self.records()), {})
        with tempfile.TemporaryDirectory() as place:
            path = Path(place) / "test.csv"
            write_columns(layout.columns, path, **layout.options)
            files = {"test.csv": path.read_bytes()}
        motion = self.trajectory()
        if motion is not None:
            files["trajectory.yaml"] = motion.to_yaml().encode("utf-8")
        return files | {"how-to-run.md": self._page(layout).encode("utf-8")}

    def trajectory(self) -> Trajectory | None:
        """Return the motion of the joints behind their gears, rad or m; None of a test that adds to the torque."""
        references = [one.reference for one in self.records() if one.reference is not None]
        if any(axis.test.injected is not None for axis in self.axes):
            return None
        positions = np.column_stack([one.values for one in references])
        for k, axis in enumerate(self.axes):
            if axis.transmission is not None and axis.transmission.side == "motor":
                positions[:, k] *= axis.transmission.torque("load") / axis.transmission.torque("motor")
        if self.from_shafts is not None:
            positions = positions @ self.from_shafts.T
        return Trajectory.of([axis.name or "joint" for axis in self.axes], positions, references[0].sample_time)

    def _page(self, layout: Layout) -> str:
        reference = self.axes[0].test.reference
        assert reference is not None
        every, length = number(1e3 * reference.sample_time, 6), number(len(reference) * reference.sample_time, 4)
        steps = [
            f"`test.csv` holds the columns {join([f'`{name}`' for name in layout.columns])}, a row every "
            f"{every} ms, {length} s."
        ]
        if self.trajectory() is not None:
            steps.append(
                "`trajectory.yaml` holds the same motion of the joints behind their gears, in rad, m and s, as a ROS 2 "
                "JointTrajectory. It has fewer rows, between which a cubic of positions and velocities is the motion."
            )
        pairs = tuple(zip(self.axes, layout.axes, strict=True))
        for (axis, played), peak in zip(pairs, self.peaks, strict=True):
            steps.append(f"{_say_motion(axis, played)}. Bring the axis there first. Its peak torque is {peak}.")
        injections = [_say_injection(axis, played) for axis, played in pairs if axis.test.injected is not None]
        kind = "robot" if self.axes[0].name else "joint"
        steps += [
            "Begin slowly, with half of the speed" + (" and a tenth of the added signal" if injections else "") + ".",
            *injections,
            "Log torque and reference, and the motor's position where the drive can: it checks the controller, too.",
            f"Then `jointid diagnose {kind}.toml --record RECORD`, and `jointid identify {kind}.toml --record RECORD`.",
        ]
        numbered = "\n".join(f"{i}. {step}" for i, step in enumerate(steps, 1))
        peak = f"Peak torque {'; '.join(self.peaks)}. {self.description}."
        return f"# A test of this {kind}\n\n{peak}\n\n{numbered}\n\n```\n{self.to_document().text()}\n```\n"


def _say_motion(axis: DesignedAxis, played: PlayedAxis) -> str:
    """State where the reference begins and stays, and on which side of a gear."""
    assert axis.test.reference is not None
    values, q = axis.test.reference.values * played.position, played.position_unit or axis.position_unit
    start, low, high = (number(float(one), 4) for one in (values[0], values.min(), values.max()))
    said = f"{axis.name or 'The reference'} begins at {start} {q} and stays between {low} and {high} {q}"
    if (gear := axis.transmission) is None:
        return said
    own = played.side or gear.side
    other: Side = "load" if own == "motor" else "motor"
    positions, factor = played.position_side or own, gear.torque(other) / gear.torque(own)
    if positions != own:
        return (
            f"{said}. Positions are of the {positions} side, torques of the {own} side: on the {own} side positions "
            f"are {1 / factor:g} times as large"
        )
    return (
        f"{said}. All numbers are of the {own} side: on the {other} side positions are {factor:g} times, torques "
        f"{1 / factor:g} times as large"
    )


def _say_injection(axis: DesignedAxis, played: PlayedAxis) -> str:
    """State how a signal is added to the torque, and how it is logged."""
    injected, unit, gear = axis.test.injected, played.torque_unit or axis.torque_unit, axis.transmission
    assert injected is not None
    side = played.side or (None if gear is None else gear.side)
    where = "before the controller's limit" if injected.at is InjectionPoint.BEFORE_LIMIT else "after its limit"
    keys = [f'unit = "{unit}"', f'at = "{injected.at}"', f"in_torque = {str(injected.in_torque).lower()}"]
    keys += [f'side = "{side}"'] if side else []
    declared = f'and declare it in the joint file: `injected = {{ column = "injected", {", ".join(keys)} }}`'
    logged = f"in the column `{played.injected}`" if played.injected else declared
    return f"Add the signal, in {unit}, to the controller's output, {where}. Log it with the same clock, {logged}."


def _columns(axes: Sequence[DesignedAxis], records: Sequence[Record]) -> dict[str, FloatArray]:
    """Columns in SI units, by the names of axis and channel."""
    found: dict[str, FloatArray] = {}
    for axis, record in zip(axes, records, strict=True):
        for name, channel in record.items():
            found.setdefault("t", channel.time)
            found[f"{axis.name}.{name}" if axis.name else name] = channel.values
    return found


def _sigma(std: float) -> str:
    return number(2 * float(std), 2) if math.isfinite(std) else "not determined"
