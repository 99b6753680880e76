"""A long record in windows: the same answer as at once, in bounded memory, and what changes on the way is seen."""

import json
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.estimation.identify import windows_of
from jointid.estimation.pieces import WindowsOfLog, begin_window
from jointid.estimation.problems.simulated import LoopLog, torque_problem
from jointid.estimation.result.verdict import Subject
from jointid.models.controllers import PD, Cascade
from jointid.records.chunks import InMemory, Log, cut
from jointid.records.formats import Table, write_table
from jointid.records.record import Channel, Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.excitation import trapezoids
from jointid.simulation.simulate import Outcome
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.rigid_axis import JOINT, LOOP, TRUTH, run

PERIOD = 1e-3
SPEEDS = (0.05, 0.1, 0.2)


def rigid(duration: float, seed: int = 1, noise: float = 2.0, **changed: float) -> Record:
    """Return laps of 10 s, after which the axis is where it began."""
    lap = trapezoids(SPEEDS, 2.0, 0.1, PERIOD)
    reference = np.tile(np.concatenate([lap, np.zeros(10_000 - lap.size)]), round(duration / 10))
    log = noise * np.random.default_rng(seed).standard_normal(reference.size)
    return simulated_record(LOOP, reference, TRUTH | changed, sample_time=PERIOD, torque_noise=log)


def joined(*records: Record) -> Record:
    """Return records one after the other."""
    changes = {}
    for name in ("torque", "reference"):
        channels = [dict(r.items())[name] for r in records]
        changes[name] = replace(channels[0], values=np.concatenate([c.values for c in channels]))
    return Record(**changes, name="joined")


def test_windows_say_what_the_whole_says() -> None:
    record = rigid(120.0)
    whole, parts = identify(record, LOOP), identify(record, LOOP, windows=5.0)
    assert parts.fit.converged
    assert parts.data.windows.count == 24
    for name, truth in TRUTH.items():
        assert abs(parts[name].value - whole[name].value) <= 0.35 * whole[name].stderr, name
        assert abs(parts[name].value - truth) <= 3.5 * whole[name].stderr, name
        assert 0.4 <= parts[name].stderr / whole[name].stderr <= 2.5, name
    assert parts.fit.filtered_error == pytest.approx(whole.fit.filtered_error, rel=0.02)


def stored(path: Path, record: Record) -> Log:
    channels = dict(record.items())
    write_table(path, Table({name: channels[name].values for name in ("torque", "reference")}))
    return Log(path, {"torque": "torque", "reference": "reference"}, {"sample_time": PERIOD, "kind": "prismatic"})


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".npy"])
def test_memory_does_not_grow_with_the_record(tmp_path: Path, suffix: str) -> None:
    short = stored(tmp_path / f"short{suffix}", rigid(60.0))  # of a text the first MiB tells the dialect
    long = stored(tmp_path / f"long{suffix}", rigid(120.0))
    identify(short, LOOP, windows=5.0)  # what is loaded once is loaded
    found = []
    for log in (short, long):
        tracemalloc.start()
        estimate = identify(log, LOOP, windows=5.0)
        found.append((tracemalloc.get_traced_memory()[1], estimate.data.windows.count))
        tracemalloc.stop()
    (before, few), (after, many) = found
    assert (few, many) == (12, 24)
    assert after <= 1.25 * before


@pytest.mark.slow
def test_a_joint_that_changes_is_seen_and_one_that_does_not_is_not() -> None:
    steady = identify(rigid(400.0), LOOP, windows=4.0)
    assert len(steady.agreement.parts) == 8
    assert not steady.agreement.differs
    warming = joined(*(rigid(100.0, seed=k, viscous=80.0 - 10.0 * k) for k in range(4)))
    estimate = identify(warming, LOOP, windows=4.0)
    assert "viscous" in estimate.agreement.names
    assert "inertia" not in estimate.agreement.names
    values = [s.values["viscous"] for s in estimate.agreement.parts]
    assert (values[0], values[-1]) == pytest.approx((80.0, 50.0), abs=5.0)


def test_windows_without_motion_are_left_out() -> None:
    still = np.zeros(20_000)
    record = rigid(40.0)
    quiet = Record(
        torque=replace(record.torque, values=2.0 + 0.1 * np.random.default_rng(0).standard_normal(still.size)),
        reference=Channel(np.full(still.size, record.reference.values[-1]), "m", PERIOD),
    )
    estimate = identify(joined(record, quiet, rigid(40.0, seed=2)), LOOP, windows=4.0)
    assert estimate.data.windows.still >= 3
    for name, truth in TRUTH.items():
        assert abs(estimate[name].value - truth) <= 4 * estimate[name].stderr


@pytest.mark.slow
def test_how_long_a_window_remembers_is_measured() -> None:
    stiff = identify(rigid(40.0), LOOP, windows=5.0)
    slow = ji.ClosedLoop(ji.RigidJoint("prismatic"), Cascade(position_gain=5.0, velocity_gain=500.0))
    reference = trapezoids(SPEEDS, 2.0, 0.1, PERIOD, duration=100.0)
    record = simulated_record(slow, reference, TRUTH, sample_time=PERIOD)
    loose = identify(record, slow, windows=10.0)
    assert stiff.data.windows.settling < 1.0 < loose.data.windows.settling
    assert loose["inertia"].value == pytest.approx(30.0, rel=1e-2)
    assert any("forgets" in warning for warning in identify(record, slow, windows=1.5).warnings)


def test_what_surrounds_the_joint_can_be_free() -> None:
    declared = ji.ClosedLoop(ji.RigidJoint("prismatic"), PD(position_gain=1.1e5, derivative_gain=2000.0))
    true = ji.ClosedLoop(ji.RigidJoint("prismatic"), PD(position_gain=1e5, derivative_gain=2000.0))
    reference = trapezoids(SPEEDS, 2.0, 0.1, PERIOD, duration=60.0)
    record = simulated_record(true, reference, TRUTH, sample_time=PERIOD)
    estimate = identify(record, declared, windows=5.0, method=ji.DIDIM(free=("position_gain",)))
    assert estimate["position_gain"].value == pytest.approx(1e5, rel=1e-4)
    assert estimate.settings.loop.controller.position_gain == pytest.approx(1e5, rel=1e-4)  # type: ignore[union-attr]
    assert "position_gain" not in estimate.values


@pytest.mark.slow
def test_a_stretch_is_silent_of_what_it_does_not_tell() -> None:
    """Both ways in the first half, forwards only in the second, which tells nothing of friction backwards."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic", friction=ji.friction.Friction("asymmetric")), LOOP.controller)
    lap = trapezoids(SPEEDS, 2.0, 0.1, PERIOD)
    both = np.tile(np.concatenate([lap, np.zeros(10_000 - lap.size)]), 10)
    out = lap[: np.argmax(lap) + 1]
    onwards = np.concatenate([i * out[-1] + out for i in range(both.size // out.size)])
    truth = {"inertia": 30.0, "offset": 0.0}
    for way, viscous, coulomb in (("forwards", 80.0, 15.0), ("backwards", 60.0, 12.0)):
        truth |= {f"viscous_{way}": viscous, f"coulomb_{way}": coulomb}
    reference = np.concatenate([both, onwards])
    log = 2.0 * np.random.default_rng(1).standard_normal(reference.size)
    record = simulated_record(loop, reference, truth, sample_time=PERIOD, torque_noise=log)
    estimate = identify(record, loop, windows=5.0)
    first, second = estimate.agreement.parts
    told = {"inertia", "viscous_forwards", "coulomb_forwards"}
    assert set(second.values) == told == {p.name for p in estimate.agreement.parameters}
    assert set(first.values) == told | {"viscous_backwards", "coulomb_backwards"}
    assert not estimate.agreement.differs


def test_windows_begin_with_a_period_of_a_controller_slower_than_the_log() -> None:
    """Windows of 5.01 s would begin in the middle of one of 4 ms: noise-free, that left 0.04 % of the torque."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), Cascade(position_gain=30.0, velocity_gain=2000.0, period=4e-3))
    lap = trapezoids(SPEEDS, 2.0, 0.1, PERIOD)
    reference = np.tile(np.concatenate([lap, np.zeros(10_000 - lap.size)]), 4)
    estimate = identify(simulated_record(loop, reference, TRUTH, sample_time=PERIOD), loop, windows=5.001)
    assert estimate.data.windows.length == pytest.approx(5.02)
    assert estimate.fit.filtered_error < 1e-5
    for name, truth in TRUTH.items():
        assert estimate[name].value == pytest.approx(truth, rel=1e-6)


def test_a_record_that_is_long_for_memory_goes_in_windows_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    record, said = rigid(40.0), list[str]()
    assert windows_of(record, LOOP, None) is None
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", len(record.reference) - 1)
    monkeypatch.setattr("jointid.estimation.identify.WINDOW", len(record.reference) // 3)
    found = ji.identify(record, LOOP, progress=said.append)
    assert found.data.windows.length == pytest.approx(40.0 / 3.0, rel=1e-3)
    expected = identify(record, LOOP, windows=found.data.windows.length)
    for name in TRUTH:
        assert found[name].value == pytest.approx(expected[name].value, rel=1e-9)
    (loop,) = (one for one in found.checks if one.name is Subject.LOOP)
    assert loop.passed is True, "the loop is checked in a part"
    said_of = "is identified in windows of 13.3 s, of which one is checked"
    assert any(said_of in one for one in said) and any(said_of in one for one in found.warnings)
    for use in (ji.design, ji.Report.of, lambda one, _: ji.figures.torque(one)):
        with pytest.raises(ji.MethodError):
            use(found, record)


@pytest.mark.slow
def test_the_part_that_is_checked_has_travel_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first quarter creeps by 10 um in its last sample, with the drive off."""
    record = rigid(40.0)
    reference, quarter = record.reference.values.copy(), len(record.reference) // 4
    reference[:quarter], reference[quarter - 1] = 0.0, 1e-5
    noise = 2.0 * np.random.default_rng(1).standard_normal(reference.size)
    record = simulated_record(LOOP, reference, TRUTH, sample_time=PERIOD, torque_noise=noise)
    torque = np.where(np.arange(len(record.torque)) < 10_500, 0.0, record.torque.values)
    record = replace(record, torque=replace(record.torque, values=torque))
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", len(record.torque) // 2)
    monkeypatch.setattr("jointid.estimation.identify.WINDOW", len(record.torque) // 6)
    found = ji.identify(record, LOOP)
    (loop,) = (one for one in found.checks if one.name is Subject.LOOP)
    assert loop.passed is True, loop


def test_what_windows_do_not_identify_takes_no_more_memory_than_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    """A log whose windows fail is not identified at once."""
    record, shown, said = rigid(20.0), list[bool](), list[str]()
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", len(record.reference) - 1)
    monkeypatch.setattr("jointid.estimation.pieces.moves", lambda records: shown.append(True))
    with pytest.raises(ji.MethodError, match="In no window"):
        ji.identify(record, LOOP)
    whole = ji.identify(record, LOOP, windows=False, checks=False, progress=said.append)
    assert shown and whole.data.windows is None
    assert "20,000 samples are identified at once, in about 1 GiB or more" in said


def test_a_window_that_fails_near_its_end_turns_the_search_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its torque is finite until there, and was as good as any."""
    part, simulated = cut(rigid(20.0), 0, 6000), LoopLog.run
    like = begin_window(torque_problem(part, LOOP, Filtering(), LOOP.joint.parameters), LOOP, [part])
    x, places = like.vector(TRUTH), lambda q, _: np.zeros(q.size, dtype=np.intp)
    windows = WindowsOfLog(like, LOOP, (InMemory(part),), [places], 2000, 500, lambda _: None)
    before = windows.pass_over(x)
    monkeypatch.setattr(LoopLog, "run", lambda *log, **kept: replace(simulated(*log, **kept), outcome=Outcome.DIVERGED))
    after = replace(windows, passes={}).pass_over(x)
    assert after.stopped and not before.stopped and after.sums.square > 1e4 * before.sums.square


def test_a_last_window_that_is_shorter_than_its_filters_is_passed_over() -> None:
    assert identify(cut(rigid(30.0), 0, 20_030), LOOP, windows=4.0).data.windows.count == 5


TEN_MINUTES = """
import sys
import numpy as np
import jointid as ji
step = 2.5e-4
lap = ji.excitation.trapezoids((0.05, 0.1, 0.2), 1.0, 0.2, step, rest=0.2)
reference = np.tile(lap, round(600 / (step * lap.size)))
loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=60.0, velocity_gain=9000.0))
truth = {"inertia": 95.0, "viscous": 205.0, "coulomb": 20.0, "offset": -3.0}
noise = 3.0 * np.random.default_rng(0).standard_normal(reference.size)
record = ji.simulated_record(loop, reference, truth, sample_time=step, torque_noise=noise)
declared = ji.controller.Cascade(position_gain=60.0, velocity_gain=float(sys.argv[1]))
found = ji.identify(record, ji.ClosedLoop(loop.joint, declared))
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # since exec, not of the parent
print(found["inertia"].value, int(peak.split()[1]) / 2**20)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of a process is in other units")
@pytest.mark.parametrize(("gain", "most"), [("9000.0", 1.0), ("7000.0", 1.5)])  # each cause that is tried holds a log
def test_ten_minutes_at_4_khz_take_little_memory(gain: str, most: float) -> None:
    done = subprocess.run([sys.executable, "-c", TEN_MINUTES, gain], capture_output=True, text=True, check=True)
    inertia, gigabytes = map(float, done.stdout.split())
    assert inertia == pytest.approx(95.0, rel=1e-3 if gain == "9000.0" else 0.3)
    assert gigabytes < most


@pytest.mark.slow
def test_a_log_is_identified_in_windows_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    joint, out = tmp_path / "joint.toml", tmp_path / "out.json"
    stored(tmp_path / "day.csv", rigid(80.0))
    joint.write_text(JOINT.replace('"run.npy"', '"day.csv"\nsample_time = 0.001'), encoding="utf-8")
    assert run("identify", joint, "--window", 4, "--json", out, "--details", "--debug") == 0
    assert "20 of 4 s" in capsys.readouterr().out
    assert json.loads(out.read_text(encoding="utf-8"))["parameters"]["inertia"]["value"] == pytest.approx(30.0, abs=0.5)
    assert run("compare", out, out) == 0
