"""A designed test of one or several axes: intervals, maxima and files."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import LOAD, MEASURED, SIMULATED, panels, styled
from jointid.common.document import Document, Documented, Facts, Table, Text, common_facts
from jointid.common.files import write_folder
from jointid.common.text import in_words, join, number
from jointid.common.transmission import Transmission
from jointid.models.limits import AxisLimits, describe_excess, units_of_limits
from jointid.planning.predict import Goal, PredictedTest
from jointid.records.record import Record, instants
from jointid.records.writing import write_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LINE = 0.45
_KNOWN = 0.1  # of a value, that its deviation is less than
_QUANTITIES = ("stroke", "speed", "acceleration", "jerk", "torque", "rms_torque", "windup")
_SPARSEST = 0.008  # s between the points of a trajectory


@dataclass(frozen=True, slots=True, eq=False)
class DesignedAxis:
    """One axis of a designed test.

    Attributes:
        name: of a robot's joint; empty of a joint alone.
        test: record without torque.
        position_unit, torque_unit: of all numbers.
        transmission: on whose `side` they are.
        limits: that the test keeps.
        given: limits that were stated; the others are taken from the present test.
        reached: maximum of each quantity over the joints of the interval.
    """

    in_json = "passed -test"
    name: str
    test: Record
    position_unit: str
    torque_unit: str
    transmission: Transmission | None
    limits: AxisLimits
    given: AxisLimits
    reached: Mapping[str, float]

    @property
    def passed(self) -> tuple[str, ...]:
        """Clauses on exceeded limits; usually none."""
        return tuple(describe_excess(self.limits, self.reached, self.units, self.name))

    @property
    def units(self) -> dict[str, str]:
        """Units of the limited quantities."""
        return units_of_limits(self.position_unit, self.torque_unit)

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the limits taken from the present test."""
        return tuple(name for name in self.limits.stated if name not in self.given.stated)

    def word(self, quantity: str) -> str:
        """Prefix a quantity with the axis's name, if it has one."""
        return f"{self.name} {quantity}".strip()

    def cell(self, quantity: str) -> str:
        """Return the reached share of a limit."""
        if quantity not in self.reached:
            return "-"
        allowed = self.limits.stated.get(quantity)
        of = "" if allowed is None else f" of {number(allowed, 3)}"
        return f"{number(self.reached[quantity], 3)}{of} {self.units[quantity]}"


@dataclass(frozen=True, slots=True, eq=False)
class Design(Documented):
    """A proposed test of a joint or robot, and its predicted intervals.

    Attributes:
        goal: parameters that the test determines.
        description: of the test, in words.
        axes: test of each axis.
        tests: predictions by the name of the test: "proposed"; if known, "present", the existing test, and "at worst",
            over the tolerance of the values.
        noise: description of the disturbance.
        floor: lower bound of the goal's standard deviation over all motions; None if unknown.
        interrupted: whether the search was interrupted before its time limit.
        notes: clauses on doubts; usually none.
        from_shafts: (n, n) the joints' positions from the references of their motors; None if they are the same.
        columns: of the file that drives play, by name; without them SI units on the joint's side.
        options: of the text of that file.
    """

    in_json = "sentence passed peaks -columns -options"
    goal: Goal
    description: str
    axes: tuple[DesignedAxis, ...]
    tests: Mapping[str, PredictedTest]
    noise: str
    floor: float | None = None
    interrupted: bool = False
    notes: tuple[str, ...] = ()
    from_shafts: FloatArray | None = None
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def proposed(self) -> PredictedTest:
        """Prediction of the new test."""
        return self.tests["proposed"]

    @property
    def present(self) -> PredictedTest | None:
        """Prediction of the test there is already; None without one."""
        return self.tests.get("present")

    @property
    def passed(self) -> tuple[str, ...]:
        """Clauses on exceeded limits; usually none."""
        return (*self.notes, *(clause for axis in self.axes for clause in axis.passed))

    @property
    def peaks(self) -> tuple[str, ...]:
        """Largest torque of each axis."""
        return tuple(axis.word(f"{number(axis.reached['torque'], 3)} {axis.torque_unit}") for axis in self.axes)

    @property
    def sentence(self) -> str:
        """Peak torque, and predicted intervals of the goal, proposed and present."""
        over = f" Beware: {'; '.join(self.passed)}." if self.passed else ""
        return f"Peak torque {'; '.join(self.peaks)}. {self._summary}.{over}"

    @property
    def _summary(self) -> str:
        present, proposed = self.present, self.proposed
        gain = None if present is None else self.goal.score(proposed) - self.goal.score(present)
        first = "The proposed test"
        if gain is not None and gain >= 0:
            first = "No better test than the present one was found: the best one"
        if self.goal.weights:
            widths = [f"{self._width(proposed)} {self._unit}"]
            widths += [f"{self._width(one)} {self._unit} at worst" for one in [self.tests.get("at worst")] if one]
            widths += [] if present is None else [f"the present one to {self._width(present)} {self._unit}"]
            return f"{first} determines {self.goal.name.replace('_', ' ')} to {', '.join(widths)}"
        known = [name for name, std in proposed.std.items() if std < _KNOWN * abs(proposed.values[name])]
        stated = f"{first} determines {len(known)} of {len(proposed.joint)} parameters to a tenth"
        if gain is None:
            return stated
        if not math.isfinite(gain):
            return f"{stated}; the present one does not show all"
        width = f"{number(100 * math.exp(gain), 3)} % of the width of the present one"
        return f"{stated}, and brings intervals on the geometric mean to {width}"

    @property
    def _unit(self) -> str:
        return self.proposed.units[next(iter(self.goal.weights))]

    def _width(self, prediction: PredictedTest) -> str:
        std = prediction.std_of(self.goal.weights)
        return f"± {number(2 * std, 2)}" if math.isfinite(std) else "no bound"

    def to_document(self, *, details: bool = False) -> Document:
        """Intervals side by side, the test, and its maxima."""
        del details
        tests, proposed = self.tests, self.proposed
        rows = []
        for name in proposed.joint:
            stds = [2 * float(prediction.std[name]) for prediction in tests.values()]
            sigmas = (number(std, 2) if math.isfinite(std) else "not determined" for std in stds)
            about, unit = number(proposed.values[name], 4), proposed.units[name]
            rows.append((in_words(name), about, *sigmas, unit, proposed.symbols[name]))
        header = ("parameter", "about", *tests, "unit", "symbol")
        reached = [
            (name.replace("_", " "), *(axis.cell(name) for axis in self.axes))
            for name in ("lower", "upper", *_QUANTITIES)
            if any(name in axis.reached for axis in self.axes)
        ]
        facts = [("test", self.description), ("noise", self.noise)]
        facts += [fact for axis in self.axes for fact in common_facts(None, axis.transmission)]
        if taken := [axis.word(in_words(name)) for axis in self.axes for name in axis.taken]:
            facts.append(("limits", f"not stated, and those which the present test reaches: {join(taken)}"))
        if self.floor is not None and self.goal.weights:
            least = f"{number(2 * self.floor, 2)} {self._unit}"
            facts.append(("floor", f"no motion within these limits comes below ± {least}"))
        if self.interrupted:
            facts.append(("search", "interrupted; this is the best test that was found until then"))
        return Document(
            self.sentence,
            (
                Table(header, tuple(rows), caption="predicted 2 sigma of", words=(0, len(header) - 2, len(header) - 1)),
                Table(
                    ("", *(axis.name or "reached" for axis in self.axes)), tuple(reached),
                    "what the test reaches, of what is allowed", tuple(range(len(self.axes) + 1)),
                ),
                Text("Neither obstacles nor the machine's own body are known here: play the test slowly first."),
                Facts(tuple(facts)),
            ),
        )  # fmt: skip

    @styled
    def plot(self) -> Figure:
        """Draw reference and predicted torque of each axis."""
        figure, drawn = panels([170] * (2 * len(self.axes)), title="the proposed test")
        for k, (axis, torque) in enumerate(zip(self.axes, self.proposed.torques, strict=True)):
            position, force = drawn[2 * k : 2 * k + 2]
            shown, reference = f"{axis.name}, " if axis.name else "", axis.test.reference
            assert reference is not None
            position.plot(reference.time, reference.values, color=MEASURED)
            position.set(xlabel="time [s]", ylabel=f"{shown}reference [{axis.position_unit}]")
            force.plot(
                instants(torque.size, self.proposed.sample_time),
                torque,
                color=SIMULATED,
                label="torque",
                linewidth=_LINE,
            )
            if axis.test.injected is not None:
                added = axis.test.injected.channel
                force.plot(added.time, added.values, color=LOAD, label="of it injected", linewidth=_LINE)
            force.set(xlabel="time [s]", ylabel=f"{shown}torque [{axis.torque_unit}]")
            force.sharex(position)
        return figure

    def records(self) -> tuple[Record, ...]:
        """Records of the axes, with reference and added torque."""
        return tuple(
            replace(axis.test, name="test", torque=None, motor_position=None, load_position=None) for axis in self.axes
        )

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the table and instructions into a folder; return the paths."""
        return write_folder(folder, self.files())

    def files(self) -> dict[str, bytes]:
        """Files of `write`, by name."""
        columns = self.columns or _columns(self.axes, self.records())
        with tempfile.TemporaryDirectory() as place:
            path = Path(place) / "test.csv"
            write_columns(columns, path, **self.options)
            files = {"test.csv": path.read_bytes()}
        if not any(axis.test.injected for axis in self.axes):
            files["trajectory.yaml"] = self.trajectory().encode("utf-8")
        return files | {"how-to-run.md": self._page(join([f"`{name}`" for name in columns])).encode("utf-8")}

    def trajectory(self) -> str:
        """Load-side motion, rad or m, as a ROS 2 JointTrajectory (YAML).

        Between two points controllers interpolate by a cubic of positions and velocities (ROS 2 control).
        """
        each = [axis.test.reference for axis in self.axes if axis.test.reference is not None]
        q, step = np.column_stack([one.values for one in each]), each[0].sample_time
        for k, axis in enumerate(self.axes):
            if axis.transmission is not None and axis.transmission.side == "motor":
                q[:, k] *= axis.transmission.torque("load") / axis.transmission.torque("motor")
        q = q if self.from_shafts is None else q @ self.from_shafts.T
        v = np.gradient(q, step, axis=0)
        lines = [f"joint_names: {json.dumps([axis.name or 'joint' for axis in self.axes])}", "points:"]
        for k in np.unique([*range(0, len(q), max(round(_SPARSEST / step), 1)), len(q) - 1]):
            for name, row in (("- positions", q[k]), ("  velocities", v[k])):
                lines.append(f"{name}: [{', '.join(f'{value:.9g}' for value in row)}]")
            seconds, nanoseconds = divmod(round(1e9 * step * float(k)), 10**9)
            lines.append(f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}")
        return "\n".join(lines) + "\n"

    def _page(self, columns: str) -> str:
        """Return how to run the test, in Markdown."""
        reference = self.axes[0].test.reference
        assert reference is not None
        kind, every = "robot" if self.axes[0].name else "joint", number(1e3 * reference.sample_time, 6)
        steps = [
            f"`test.csv` holds the columns {columns}, a row every {every} ms. Bring the axis to its first row first.",
            "Begin slowly, with half of the speed and, where a signal is added, a tenth of it.",
        ]
        for added in [axis.test.injected for axis in self.axes if axis.test.injected is not None]:
            keys = f'at = "{added.at}", in_torque = {str(added.in_torque).lower()}'
            steps.append(
                "Add the signal to the controller's output, and log it with the same clock. The joint file has it, "
                f'with unit and side: `injected = {{ column = "injected", {keys} }}`.'
            )
        steps += [
            "Log torque and reference, and the motor's position where the drive can: it checks the controller, too.",
            f"Then `jointid diagnose {kind}.toml --record RECORD`, and `jointid identify {kind}.toml --record RECORD`.",
        ]
        numbered = "\n".join(f"{i}. {step}" for i, step in enumerate(steps, 1))
        return f"# A test of this {kind}\n\n{numbered}\n\n```\n{self.to_document().text()}\n```\n"


def _columns(axes: Sequence[DesignedAxis], records: Sequence[Record]) -> dict[str, FloatArray]:
    """Columns in SI units, by the names of axis and channel."""
    found: dict[str, FloatArray] = {}
    for axis, record in zip(axes, records, strict=True):
        for name, channel in record.items():
            found.setdefault("t", channel.time)
            found[f"{axis.name}.{name}" if axis.name else name] = channel.values
    return found
