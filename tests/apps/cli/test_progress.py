"""Long work as a user sees it: bars on a terminal, a line now and then elsewhere, nothing where none is wanted."""

from __future__ import annotations

import io
import math
import sys
from collections.abc import Callable
from itertools import count

import pytest
from rich.console import Console

import jointid as ji
from jointid.apps.cli import console
from jointid.apps.cli.terminal import Bars
from jointid.common.messages import (
    Detail,
    Suspicion,
    describe_pace,
    describe_time,
    follow,
    ignore_progress,
    name_progress,
)


class Drawn:
    """A listener that remembers what it hears."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.drawn: list[tuple[str, float, float, str]] = []

    def __call__(self, message: str) -> None:
        self.said.append(message)

    def draw(self, what: str, done: float, total: float, unit: str) -> None:
        self.drawn.append((what, done, total, unit))


def test_a_rate_and_the_time_left_are_of_what_was_done() -> None:
    assert describe_pace(30, 120, "draws", 10.0) == "30 of 120 draws, 30 s left, 3/s"
    assert describe_pace(25.0, 100.0, "%", 60.0) == "25 %, 3 min left"
    assert describe_pace(0, 120, "draws", 10.0) == "0 of 120 draws"
    assert [describe_time(s) for s in (0.2, 99.0, 300.0, 7200.0)] == ["1 s", "99 s", "5 min", "2.0 h"]


def test_where_no_bar_is_drawn_a_line_comes_after_three_seconds_and_then_every_ten(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    seconds = count()
    monkeypatch.setattr("time.monotonic", lambda: float(next(seconds)))
    said: list[str] = []
    assert list(follow(range(35), said.append, "bootstrapping", 35, "draws")) == list(range(35))
    assert len(said) == 4
    assert said[0] == "bootstrapping: 2 of 35 draws, 50 s left, 0.67/s"
    assert said[1].startswith("bootstrapping: 12 of 35 draws")
    list(follow(range(2), said.append, "short", 2, "draws"))
    assert len(said) == 4


def test_work_of_unknown_length_tells_what_is_done_and_how_fast() -> None:
    assert describe_pace(30, math.inf, "windows", 10.0) == "30 windows, 3/s"
    drawn = Drawn()
    assert list(follow("abc", drawn, "passing over the log", math.inf, "windows")) == ["a", "b", "c"]
    assert drawn.drawn[-1] == ("passing over the log", math.inf, math.inf, "windows")


def test_the_first_pass_over_a_log_is_drawn_too() -> None:
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), 2.0, 0.1, 1e-3, duration=30.0)
    truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
    drawn = Drawn()
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    ji.identify(record, loop, windows=ji.Windowing(length=6.0), progress=drawn)
    first, second = [one for one in drawn.drawn if one[0] == "passing over the log"][:2]
    assert first == ("passing over the log", 0, math.inf, "windows")
    assert second == ("passing over the log", 1, math.inf, "windows")


def test_bars_show_rate_and_time_left_and_leave_nothing_behind() -> None:
    file = io.StringIO()
    bars = Bars(Console(file=file, force_terminal=True, width=110))
    bars("a stage [of a file]")
    bars.clear()
    bars.draw("bootstrapping", 0, 40, "draws")
    bars.draw("bootstrapping", 12, 40, "draws")
    bars("a sentence [of a file]")
    bars.draw("passing over the log", 3, math.inf, "windows")
    bars.draw("bootstrapping", 40, 40, "draws")
    bars.draw("passing over the log", math.inf, math.inf, "windows")
    shown = file.getvalue()
    for text in ("a stage [of a file]", "bootstrapping: 12 of 40 draws", "a sentence [of a file]", "3 windows"):
        assert text in shown
    assert shown.endswith("\x1b[2K"), "the line is erased"


@pytest.mark.parametrize("terminal", [True, False])
def test_who_listens_depends_on_the_terminal(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    assert console.listen(quiet=True) is ignore_progress
    assert isinstance(console.listen(quiet=False), Bars) == terminal


def test_details_are_for_who_asks_for_them(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def search(listener: Callable[[str], None]) -> list[str]:
        listener("searching the spring")
        listener(Detail("iteration 0: torque error 17 %"))
        listener(Suspicion("searching by least squares", "The loop is not stable; check the gain."))
        name_progress(listener, "record 2")(Detail("iteration 1: torque error 10 %"))
        listener("searching by least squares")
        return capsys.readouterr().err.splitlines()

    assert search(console.listen(quiet=False)) == ["searching the spring", "searching by least squares"]
    monkeypatch.setattr(console, "details", True)
    told = search(console.listen(quiet=False))
    assert told[1] == "iteration 0: torque error 17 %" and told[2].endswith("check the gain.")
    assert told[3] == "record 2: iteration 1: torque error 10 %"
