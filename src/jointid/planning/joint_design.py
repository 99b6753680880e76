"""Design of the most informative test of a joint within its axis limits.

Prior knowledge comes from an estimate or is stated. The search (`search`) uses several joints of its interval; the best
test is then simulated at many more, so that none exceeds a limit. The present test, a load encoder and twice the time
are predicted for comparison.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import LOAD, MEASURED, SIMULATED, Chart, Line, Mark, Panel
from jointid.common.document import Block, Document, Documented, Facts, Table, common_facts
from jointid.common.errors import JointidError, MethodError
from jointid.common.files import write_folder
from jointid.common.matplotlib_backend import Charted
from jointid.common.messages import Progress, Work, ignore_progress
from jointid.common.parameters import POSITION_UNIT, Parameter, Quantity
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.diagnostics.other_experiments import choose_encoder_steps
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.limits import AxisLimits, describe_excess, find_excess, units_of_limits
from jointid.planning.bound import Floor, least_deviation
from jointid.planning.goals import WEAKEST, Goal, parse_goal
from jointid.planning.plans import Plan, TorqueTable, room_of
from jointid.planning.plans import Table as Played
from jointid.planning.predict import Noise, PredictedTest, reach
from jointid.planning.search import Asked, Purpose, Tried, search, try_plan
from jointid.records.record import Channel, InjectionPoint, Record, Tap, Timing
from jointid.records.signals.filtering import Filtering
from jointid.records.writing import write

_JOINTS = 2  # of the interval, beside the one that is roughly known, in the search
_MORE_JOINTS = 20  # of the interval, at which the result is simulated
_SHRINKS = 0.95  # of a signal, where the result passes a limit at one of these
_TRIES = 12
_CANDIDATES = 6  # of a search, that are simulated at more joints
_FEWEST = 200  # samples of a test
_LEAST = 0.2  # of an inertia or a stiffness that is drawn: less is no joint that was identified
_TELLS_MORE = 0.95  # of a deviation
_LINE = 0.6


@dataclass(frozen=True, slots=True, eq=False)
class Design(Charted, Documented):
    """A proposed test and its predicted intervals.

    Attributes:
        record: of what is roughly known; empty where it was stated.
        loop: joint and controller.
        goal: what the test is to tell.
        description: of the test, in words.
        present: the test there is already, predicted; None where there is none, or it does not tell every parameter.
        present_passes: clauses on limits that the present test passes.
        proposed: the new one.
        test: the same as a record without a torque yet.
        with_motor_encoder: the new one with an encoder on the motor beside; None where that tells nothing new, as where
            forces in the loop disturb the axis: the torque shows all that the loop does.
        with_encoder: with one on the load; None of a rigid joint.
        longer: the new one for twice the time; None of a test of one's own.
        reached, limits: of each quantity, the largest over the joints that it was simulated at, and what is allowed.
        from_present: names of the limits that are those of the present test.
        passed: clauses on limits that are passed; none as a rule.
        floor: standard deviation of the goal below which no motion comes; None where it is not known.
        modes: Hz, of the joint as it is roughly known, by name; none of a rigid one.
        interrupted: whether the search was, before its time was over.
    """

    record: str
    loop: ClosedLoop
    goal: Goal
    description: str
    present: PredictedTest | None
    present_passes: tuple[str, ...]
    proposed: PredictedTest
    test: Record
    with_motor_encoder: PredictedTest | None
    with_encoder: PredictedTest | None
    longer: PredictedTest | None
    reached: Mapping[str, float]
    limits: Mapping[str, float]
    from_present: tuple[str, ...]
    passed: tuple[str, ...]
    floor: float | None
    modes: Mapping[str, float] = field(default_factory=dict)
    interrupted: bool = False

    @property
    def position_unit(self) -> str:
        """Of reference and stroke."""
        return POSITION_UNIT[self.loop.joint.kind]

    @property
    def torque_unit(self) -> str:
        """Of the torque."""
        return self.loop.joint.force_unit

    @property
    def transmission(self) -> Transmission | None:
        """The transmission on whose `side` all numbers are."""
        return self.loop.joint.transmission

    @property
    def sentence(self) -> str:
        """Predicted interval of the goal, compared with the present test."""
        over = f" Beware: {'; '.join(self.passed)}." if self.passed else ""
        return f"{self._summary}.{over}"

    @property
    def _summary(self) -> str:
        better = self.present is None or self._score(self.proposed) < self._score(self.present)
        over = "; ".join(self.present_passes)
        if over:
            first = f"Of the present test: {over}. The best test found within the limits"
        else:
            first = "The proposed test" if better else "No better test than the present one was found: the best one"
        if not self.goal.weights:
            if self.present is None:
                return f"{first} is the best found for the goal {self.goal.name}"
            ratio = number(100 * math.exp(self._score(self.proposed) - self._score(self.present)), 3)
            what = "worst known direction" if self.goal.name == WEAKEST else "intervals, on the geometric mean,"
            return f"{first} brings the {what} to {ratio} % of the width that the present one gives"
        unit = self.proposed.units[next(iter(self.goal.weights))]
        width = number(2 * self.proposed.std_of(self.goal.weights), 2)
        prediction = f"{first} tells {self.goal.name.replace('_', ' ')} to +- {width} {unit}"
        if self.present is None:
            return prediction
        return f"{prediction}, the present one to +- {number(2 * self.present.std_of(self.goal.weights), 2)} {unit}"

    def _score(self, prediction: PredictedTest) -> float:
        return self.goal.score(prediction.covariance.matrix, prediction.joint, prediction.values)

    @property
    def tests(self) -> dict[str, PredictedTest]:
        """Predictions by the name of the test."""
        found = {
            "present": self.present,
            "proposed": self.proposed,
            "with motor encoder": self.with_motor_encoder,
            "with load encoder": self.with_encoder,
            "twice the time": self.longer,
        }
        return {name: prediction for name, prediction in found.items() if prediction is not None}

    def to_document(self, *, details: bool = False) -> Document:
        """Intervals side by side, the test, and its maxima."""
        del details
        tests, proposed = self.tests, self.proposed
        rows = []
        for name in proposed.joint:
            stds = (number(2 * prediction.std[name], 2) for prediction in tests.values())
            rows.append((proposed.symbols[name], number(proposed.values[name]), *stds, proposed.units[name]))
        # Torque alone hardly separates the parameters of both sides.
        motor = [name for name in proposed.joint if name.startswith("motor_") and "inertia" not in name]
        for pair in [(name, f"load_{name[6:]}") for name in motor if f"load_{name[6:]}" in proposed.joint]:
            for sign in (1.0, -1.0):
                weights = {pair[0]: 1.0, pair[1]: sign}
                shown = f"{proposed.symbols[pair[0]]} {'+' if sign > 0 else '-'} {proposed.symbols[pair[1]]}"
                value = proposed.values[pair[0]] + sign * proposed.values[pair[1]]
                stds = (number(2 * prediction.std_of(weights), 2) for prediction in tests.values())
                rows.append((shown, number(value), *stds, proposed.units[pair[0]]))
        header = ("symbol", "about", *tests, "unit")
        blocks: list[Block] = [Table(header, tuple(rows), caption="predicted 2 sigma of", words=(0, len(header) - 1))]
        facts = [("test", self.description), *common_facts(None, self.transmission)]
        units = units_of_limits(self.loop)
        for name, size in self.reached.items():
            allowed = (
                f"of {number(self.limits[name], 3)} {units[name]}"
                f"{', which the present test reaches' if name in self.from_present else ''}"
                if name in self.limits
                else f"{units[name]}, not limited"
            )
            facts.append((name.replace("_", " "), f"{number(size, 3)} {allowed}"))
        if self.floor is not None and self.goal.weights:
            unit = proposed.units[next(iter(self.goal.weights))]
            facts.append(("floor", f"no motion within these limits comes below +- {number(2 * self.floor, 2)} {unit}"))
        if self.interrupted:
            facts.append(("search", "interrupted; this is the best that was found until then"))
        blocks.append(Facts(tuple(facts)))
        return Document(self.sentence, tuple(blocks))

    def chart(self) -> Chart:
        """Plot reference and predicted torque, and their spectra beside the modes."""
        torque, T = self.proposed.motion.torque, self.proposed.sample_time
        q, u = self.position_unit, self.torque_unit
        lines = [Line(_times(torque.size, T), torque, SIMULATED, "torque", width=_LINE)]
        if (injected := self.test.injected) is not None:
            added = injected.channel
            lines.append(Line(_times(len(added), added.sample_time), added.values, LOAD, "of it injected", width=_LINE))
        reference = self.test.reference
        assert reference is not None
        motion = Line(_times(len(reference), reference.sample_time), reference.values, MEASURED)
        hertz = np.asarray(np.fft.rfftfreq(torque.size, T)[1:], dtype=np.float64)
        size = np.abs(np.fft.rfft(torque - torque.mean()))[1:] * 2 / torque.size
        kept = hertz <= 4 * max([*self.modes.values(), 25.0])
        marks = tuple(Mark(f, name.replace("_", " "), row) for row, (name, f) in enumerate(self.modes.items()))
        spectrum = Line(hertz[kept], size[kept], SIMULATED, width=_LINE)
        panels = (
            Panel("time [s]", f"reference [{q}]", (motion,), height=170, group="time"),
            Panel("time [s]", f"torque [{u}]", tuple(lines), height=170, group="time"),
            Panel("frequency [Hz]", f"torque [{u}]", (spectrum, *marks), height=170),
        )
        return Chart("test", "", panels, title="the proposed test")

    def write(self, folder: Path) -> tuple[Path, ...]:
        """Write CSV and MAT tables and instructions into a folder; return the paths."""
        return write_folder(folder, self.files())

    def files(self) -> dict[str, bytes]:
        """Files of `write`, by name."""
        record = replace(self.test, name="test", torque=None, motor_position=None, load_position=None)
        files: dict[str, bytes] = {}
        with tempfile.TemporaryDirectory() as place:
            for name in ("test.csv", "test.mat"):
                write(record, Path(place) / name)
                files[name] = (Path(place) / name).read_bytes()
        files["how-to-run.md"] = self._page().encode("utf-8")
        return files

    def _page(self) -> str:
        u, q, reference = self.torque_unit, self.position_unit, self.test.reference
        assert reference is not None
        every, length = number(1e3 * reference.sample_time, 6), number(len(reference) * reference.sample_time, 4)
        played = reference.values
        start, low, high = (number(float(one), 4) for one in (played[0], played.min(), played.max()))
        added, injected = "", self.test.injected
        if injected is not None:
            where = "before the controller's limit" if injected.at is InjectionPoint.BEFORE_LIMIT else "after its limit"
            added = f", and the signal to add to the controller's output, {where}, in {u}"
        gear = self.transmission
        side, sided = "", ""
        if gear is not None:
            far, sided = gear.torque(gear.other), f', side = "{gear.side}"'
            side = (
                f" All numbers are of the {gear.side} side: on the {gear.other} side positions are {far:g} "
                f"times, torques {1 / far:g} times as large."
            )
        steps = [
            f"`test.csv` and `test.mat` hold the reference in {q}{added}, a row every {every} ms, {length} s.{side}",
            f"It begins at {start} {q} and stays between {low} and {high} {q}: bring the axis there first.",
            "Begin slowly, with half of the speed" + (" and a tenth of the added signal" if injected else "") + ".",
            "Log torque and reference, and the motor's position where the drive can: it checks the controller, too.",
        ]
        if injected is not None:
            inside = "true" if injected.in_torque else "false"
            steps.append(
                "Log the added signal with the same clock, and declare it in the joint file: `injected = { column = "
                f'"injected", unit = "{u}", at = "{injected.at}", in_torque = {inside}{sided} }}`.'
            )
        steps.append(
            "Then `jointid examine joint.toml --record RECORD`, and `jointid identify joint.toml --record RECORD`."
        )
        numbered = "\n".join(f"{i}. {step}" for i, step in enumerate(steps, 1))
        return f"# A test of this joint\n\n{self.description}.\n\n{numbered}\n\n{self.to_document().markdown()}\n"


def design_joint_test(
    loop: ClosedLoop,
    values: Mapping[str, float],
    noise: Noise,
    *,
    goal: str = "all",
    limits: AxisLimits | None = None,
    present: Record | None = None,
    motion: Record | None = None,
    covariance: FloatArray | None = None,
    duration: float | None = None,
    sample_time: float | None = None,
    tap: Tap | str = Tap.COMMAND,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    encoder: float | None = None,
    seconds: float = 60.0,
    seed: int = 0,
    name: str = "",
    progress: Progress = ignore_progress,
) -> Design:
    """Design the test of a joint whose values are roughly known; see `jointid.design`.

    `present` is the test there is already, `tap` where the torque of the new one will be logged.
    """
    filtering, parameters = filtering or Filtering(), parameters or {}
    for given, what in ((duration, "duration"), (sample_time, "sample time"), (seconds, "time of the search")):
        if given is not None and not (math.isfinite(given) and given > 0):
            raise MethodError(f"The {what} is a positive number of seconds; received {given:g}.")
    if present is not None:
        present.require(("reference",), "A design from a test there is already")
    lasts = motion if motion is not None else present
    if lasts is None and (duration is None or sample_time is None):
        raise MethodError(
            "A test has a duration and a sample time; give both, or the record of a test there is already."
        )
    known = present if present is not None else motion
    log = None if known is None else known.torque or known.reference
    T = sample_time or (log.sample_time if log is not None else 0.0)
    samples = math.floor((duration or (lasts.duration if lasts is not None else 0.0)) / T + 1e-9)
    if samples < _FEWEST:
        raise MethodError(f"A test of {samples} samples tells nothing; expected {_FEWEST} or more: plan a longer one.")
    tap = Tap(tap)
    unknown = {p.name: parameters.get(p.name, p) for p in loop.joint.parameters}
    free = [name for name, p in unknown.items() if p.free]
    wanted = parse_goal(goal, {name: loop.joint.unit(unknown[name]) for name in free})
    draws = _draw(values, [unknown[name] for name in free], covariance, _MORE_JOINTS, seed)
    stated_limits = limits or AxisLimits()
    purpose = Purpose(loop, (dict(values), *draws), noise, wanted, samples, T, tap, filtering, parameters)
    if motion is None:
        before = None if present is None else reach(loop, values, present, noise, filtering, parameters)
        chosen = _search(purpose, stated_limits, present, before, seconds, seed, progress)
    else:
        before = None
        chosen = _take(purpose, stated_limits, motion)
    prediction = purpose.predict(chosen.test)
    steps = choose_encoder_steps(chosen.test if present is None else present, encoder)
    on_motor = purpose.predict(chosen.test, motor_encoder=steps[0])
    flexible = isinstance(loop.joint, FlexibleJoint)
    current = None
    if present is not None:
        with contextlib.suppress(JointidError):
            current = purpose.predict(present)
    units = units_of_limits(loop)
    reached = {**chosen.reached, **_positions(stated_limits, chosen.test)}
    return Design(
        name,
        loop,
        wanted,
        chosen.description,
        current,
        () if before is None else tuple(describe_excess(stated_limits, before, units)),
        prediction,
        chosen.test,
        on_motor if any(on_motor.std[name] < _TELLS_MORE * std for name, std in prediction.std.items()) else None,
        purpose.predict(chosen.test, load_encoder=steps[1]) if flexible else None,
        None if chosen.longer is None else purpose.predict(chosen.longer),
        reached,
        chosen.limits.stated,
        tuple(name for name in chosen.limits.given if name not in stated_limits.given),
        (*chosen.beware, *describe_excess(chosen.limits, reached, units)),
        chosen.floor,
        FlexibleJoint.frequencies(values) if flexible else {},
        chosen.interrupted,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Chosen:
    """A test as a description and a record, with its maxima and limits.

    `beware` holds notes beside exceeded limits.
    """

    description: str
    test: Record
    longer: Record | None
    reached: Mapping[str, float]
    limits: AxisLimits
    beware: tuple[str, ...] = ()
    floor: float | None = None
    interrupted: bool = False


def _search(
    purpose: Purpose,
    limits: AxisLimits,
    present: Record | None,
    before: Mapping[str, float] | None,
    seconds: float,
    seed: int,
    progress: Progress,
) -> _Chosen:
    """Search within the stated limits and those of the present test."""
    loop, values, T = purpose.loop, purpose.joints[0], purpose.sample_time
    limits, found = _complete(limits, before)
    resolved = purpose.filtering.resolve(T, loop.joint.model)
    assert resolved.cutoff is not None
    highest = min(limits.highest or resolved.cutoff, resolved.cutoff)
    floor = _floor(loop, values, purpose.noise, purpose.goal, limits, purpose.samples, T, highest)
    flexible = isinstance(loop.joint, FlexibleJoint)
    mode = FlexibleJoint.frequencies(values)["free_free"] if flexible else 0.5 * highest
    positions = np.zeros(1) if present is None or present.reference is None else present.reference.values
    lines = () if floor is None else floor.lines
    lowest = min(limits.lowest, highest)
    stroke = limits.given["stroke"]
    low = 0.5 * float(positions.min() + positions.max() - stroke)
    if limits.lower is not None or limits.upper is not None:
        low = limits.lower if limits.lower is not None else limits.stated["upper"] - stroke
    room = room_of(limits.given, found, lowest, highest, mode, lines, low)
    added = None if present is None else present.injected
    how = (InjectionPoint.AFTER_LIMIT, True) if added is None else (added.at, added.in_torque)
    asked = Asked(replace(purpose, joints=purpose.joints[: 1 + _JOINTS]), limits, room, *how)
    inside = present is not None and not find_excess(limits, _positions(limits, present))
    begin = _as_plan(present, T) if present is not None and inside else ()
    candidates, interrupted = _look(asked, begin, seconds, seed, progress)
    best, ended = _choose(replace(asked, purpose=purpose), candidates, progress)
    where = "at some joints of the interval it cannot be simulated, or tells nothing of a parameter"
    return _Chosen(
        best.plan.describe(POSITION_UNIT[loop.joint.kind], loop.joint.force_unit),
        asked.record(best.plan),
        asked.record(best.plan, 2 * purpose.samples),
        best.reached,
        limits,
        (where,) if math.isinf(best.over) else (),
        None if floor is None or math.isnan(floor.deviation) else floor.deviation,
        interrupted or ended,
    )


def _positions(limits: AxisLimits, test: Record) -> dict[str, float]:
    """Extreme positions of a test's reference, where they are limited."""
    if test.reference is None or (limits.lower is None and limits.upper is None):
        return {}
    return {"lower": float(test.reference.values.min()), "upper": float(test.reference.values.max())}


def _take(purpose: Purpose, limits: AxisLimits, motion: Record) -> _Chosen:
    """Take the user's own test or a past record; only stated limits apply."""
    reference = motion.reference
    if reference is None:
        raise MethodError("A test of your own has a reference; give the position that the axis is to follow.")
    test = motion
    if motion.torque is None:
        zeros = np.zeros(purpose.samples)
        test = replace(motion, torque=Channel(zeros, purpose.loop.joint.force_unit, purpose.sample_time, Timing.HELD))
    most = dict[str, float]()
    for prediction in purpose.predict_roughly(test):
        most = {name: max(size, most.get(name, 0.0)) for name, size in prediction.reached.items()}
    q, u = POSITION_UNIT[purpose.loop.joint.kind], purpose.loop.joint.force_unit
    words = Played(reference.values).describe(q)
    if motion.injected is not None:
        words = f"{words}; {TorqueTable(motion.injected.channel.values).describe(u)}"
    return _Chosen(words, test, None, most, limits)


def _complete(limits: AxisLimits, before: Mapping[str, float] | None) -> tuple[AxisLimits, dict[str, float]]:
    """Complete the limits from the present test, and return its maxima."""
    needed = ("stroke", "speed", "acceleration", "torque")
    if before is None:
        missing = [name for name in needed if name not in limits.given]
        if missing:
            raise MethodError(
                f"Without a test there is already, a search needs limits of {', '.join(needed)}; "
                f"{', '.join(missing)} {'are' if len(missing) > 1 else 'is'} missing: give them."
            )
        return limits, {name: limits.given[name] for name in needed}
    taken = {name: before[name] for name in ("stroke", "torque", "rms_torque") if name not in limits.given}
    return replace(limits, **taken), dict(before)


def _as_plan(present: Record, sample_time: float) -> tuple[Plan, ...]:
    """The present test as a first candidate, if it has the log's sample time."""
    assert present.reference is not None
    injected = present.injected
    rates = {present.reference.sample_time, *([] if injected is None else [injected.channel.sample_time])}
    if rates != {sample_time}:
        return ()
    added = None if injected is None else TorqueTable(injected.channel.values)
    return (Plan(Played(present.reference.values), added),)


def _floor(
    loop: ClosedLoop, values: Mapping[str, float], noise: Noise, goal: Goal, limits: AxisLimits, samples: int,
    sample_time: float, cutoff: float,
) -> Floor | None:  # fmt: skip
    """Lower bound of a goal; white noise of equal size replaces a first record's."""
    known = noise.left is None
    size = 1.0 if noise.left is None else float(np.sqrt(np.mean(noise.left**2)))
    asked = goal if goal.weights else Goal("stiffness", {"stiffness": 1.0})
    try:
        floor = least_deviation(
            loop, values, noise if known else Noise(force=size), asked, limits, samples=samples,
            sample_time=sample_time, cutoff=cutoff,
        )  # fmt: skip
    except MethodError:
        return None
    return floor if known and goal.weights else replace(floor, deviation=math.nan)


def _draw(
    values: Mapping[str, float], free: Sequence[Parameter], covariance: FloatArray | None, count: int, seed: int
) -> list[dict[str, float]]:
    """Draw joints from the interval, within the parameters' bounds, if known."""
    if covariance is None:
        return []
    rng = np.random.default_rng([seed, 1])
    moved = rng.multivariate_normal(np.zeros(len(free)), covariance, size=count, method="eigh")
    drawn = []
    for row in moved:
        one = dict(values)
        for p, by in zip(free, map(float, row), strict=True):
            least = _LEAST * values[p.name] if p.quantity in (Quantity.INERTIA, Quantity.STIFFNESS) else p.lower
            one[p.name] = min(max(values[p.name] + by, least), p.upper)
        drawn.append(one)
    return drawn


def _look(
    asked: Asked, begin: Sequence[Plan], seconds: float, seed: int, progress: Progress
) -> tuple[list[Tried], bool]:
    """Return successively better tests, and whether the search was interrupted."""
    found: list[Tried] = []
    interrupted = False
    try:
        for tried in search(asked, begin, seconds, progress, seed=seed):
            found.append(tried)
    except KeyboardInterrupt:
        if not found:
            raise
        interrupted = True
    if not found or math.isinf(found[-1].over):
        raise MethodError(
            "No test could be simulated within these limits; check the limits, the controller and the values."
        )
    return found, interrupted


def _choose(asked: Asked, found: Sequence[Tried], progress: Progress) -> tuple[Tried, bool]:
    """Return the best test at all joints, and whether it was interrupted.

    A test that has to be reduced to keep the limits may be worse than its predecessor.
    """
    kept: list[Tried] = []
    last = found[-_CANDIDATES:]
    work = Work(progress, "trying the best of them at other joints of the interval", float(len(last)), "tests")
    try:
        for tried in reversed(last):
            kept.append(_keep_within(asked, tried))
            work.reach(float(len(kept)))
            if kept[-1].plan is tried.plan and kept[-1].over <= 1.0:
                break
    except KeyboardInterrupt:
        return min(kept or [found[-1]], key=lambda tried: tried.rank), True
    return min(kept, key=lambda tried: tried.rank), False


def _keep_within(asked: Asked, best: Tried) -> Tried:
    """Reduce a test's added signal and speed until it keeps the limits at all joints."""
    tried = try_plan(asked, best.plan, margin=1.0)
    for _ in range(_TRIES):
        smaller = tried.plan.scale(_SHRINKS)
        same = smaller.motion is tried.plan.motion and smaller.added is tried.plan.added
        if tried.over <= 1.0 or math.isinf(tried.over) or same:
            break
        tried = try_plan(asked, smaller, margin=1.0)
    return tried


def _times(samples: int, sample_time: float) -> FloatArray:
    return np.asarray(np.arange(samples) * sample_time, dtype=np.float64)
