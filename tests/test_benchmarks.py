"""The benchmarks measure what they say: one problem, one reference, peers within the errors they state. No times."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks import figures, growth, identification, measuring, page
from benchmarks.clocked import core_seconds
from benchmarks.peers import PEERS, mujoco_sysid, peer
from benchmarks.peers.c_stick import CStick, stick_module
from benchmarks.peers.engine import Engine
from benchmarks.peers.shape import Peer, Setting
from benchmarks.problem import EMPS, LAWS, STICK, TRUTH, Law, candidates, loop_of
from benchmarks.reference import Reference, reference_of
from benchmarks.results import (
    Footprint,
    LoopResult,
    Own,
    Point,
    Release,
    Results,
    Rigid,
    Row,
    Size,
    Solver,
    Spread,
    Timed,
    load,
    save,
    spread,
)
from jointid.paper.twin import twin

SHORT = 2000  # samples: a stroke, two standstills and pulses


@cache
def reference(law: Law) -> Reference:
    return reference_of(loop_of(law).first(SHORT))


def made(kind: type[Peer], law: Law, setting: Setting | None = None, samples: int = SHORT) -> Peer:
    if reason := kind.absent(loop_of(law)):
        pytest.skip(f"{kind.key}: {reason}")
    return kind(loop_of(law).first(samples), setting or kind.settings[0])


def test_the_problem_is_that_of_the_stick(bench_dir: Path) -> None:
    theirs, ours = stick_module("stick").problem(), loop_of(STICK)
    assert np.array_equal(theirs["parameters"], TRUTH)
    assert np.max(np.abs(theirs["reference"] - ours.reference)) <= 1e-15
    assert np.max(np.abs(theirs["reference_velocity"] - ours.reference_velocity)) <= 1e-15
    assert np.array_equal(theirs["pulse"], ours.pulse)
    gains = theirs["controller"]
    law = ours.law
    assert (gains["kp"], gains["kd"], gains["alpha"], gains["umax"]) == (
        law.position_gain,
        law.derivative_gain,
        law.memory,
        law.limit,
    )
    assert (law.now, law.before, theirs["sample_time"]) == (1 - gains["alpha"], 0.0, 1e-3)


@pytest.mark.slow
def test_the_reference_meets_standstills_and_reversals() -> None:
    for law in LAWS:
        assert reference(law).events >= 15
        assert 200.0 < reference(law).peak < 300.0


def test_an_error_is_a_share_of_the_peak() -> None:
    found = reference(STICK)
    moved = found.torque.copy()
    moved[7] += 0.01 * found.peak
    assert found.error(moved) == pytest.approx(0.01)
    moved[8] = np.nan
    assert found.error(moved) == np.inf


CASES = [(key, law, setting) for key in PEERS for law in LAWS for setting in peer(key).settings]


@pytest.mark.slow
@pytest.mark.parametrize(("key", "law", "setting"), CASES, ids=[f"{k}-{law.key}-{s.label}" for k, law, s in CASES])
def test_a_peer_errs_no_more_than_it_says(key: str, law: Law, setting: Setting) -> None:
    """And not by chance: an error that is asked for ten times smaller is not met, but by the exact ones."""
    error = reference(law).error(made(peer(key), law, setting).torque(TRUTH))
    assert error <= setting.error
    assert error > setting.error / 20 or setting.friction == "exact"


@pytest.mark.parametrize("key", ["jointid", "c", "jax", "casadi"])
def test_exact_derivatives_are_those_of_the_torque(key: str) -> None:
    simulated = made(peer(key), STICK)
    torque, slopes = (np.array(found) for found in simulated.slopes(TRUTH))
    # A wider step than a peer's own: JAX's matrix exponential is good to ten digits.
    steps = 1e-5 * TRUTH * np.eye(TRUTH.size)
    differences = np.column_stack([(np.array(simulated.torque(TRUTH + by)) - torque) / by.sum() for by in steps])
    assert slopes.shape == (SHORT, TRUTH.size)
    # Where a held friction turns from sticking to sliding the torque has a kink, and the two differ there.
    assert np.all(np.linalg.norm(slopes - differences, axis=0) <= 1e-2 * np.linalg.norm(differences, axis=0))


@pytest.mark.parametrize("key", ["mujoco", "rollout", "control"])
def test_derivatives_by_differences_point_where_the_exact_ones_do(key: str) -> None:
    best = (min(kind.settings, key=lambda setting: setting.error) for kind in (peer(key), Engine))
    found, exact = (
        made(kind, STICK, setting, samples=1000).slopes(TRUTH)[1]
        for kind, setting in zip((peer(key), Engine), best, strict=True)
    )
    lengths = np.linalg.norm(found, axis=0) * np.linalg.norm(exact, axis=0)
    assert np.all(np.sum(found * exact, axis=0) >= (0.5 if key == "rollout" else 0.95) * lengths)


@pytest.mark.parametrize("key", [key for key in PEERS if key not in ("control", "scipy")])
@pytest.mark.parametrize("count", [3, 16])
def test_a_batch_is_its_members(key: str, count: int) -> None:
    simulated, many = made(peer(key), STICK), candidates(count)
    alone = [np.array(simulated.torque(parameters)) for parameters in many]
    found = simulated.batch(many)
    assert len(found) == count
    assert all(
        np.max(np.abs(one - other)) <= 1e-8 * np.max(np.abs(one)) for one, other in zip(alone, found, strict=True)
    )


def test_the_c_version_is_this_package(bench_dir: Path) -> None:
    theirs, ours = (made(kind, STICK).torque(TRUTH) for kind in (CStick, Engine))
    assert np.max(np.abs(theirs - ours)) <= 1e-10 * np.max(np.abs(ours))


def test_the_kernel_alone_can_be_run_again() -> None:
    engine = made(Engine, STICK)
    assert isinstance(engine, Engine)
    call = engine.kernel(TRUTH)
    before = engine.torque(TRUTH)
    call()
    call()
    assert np.array_equal(engine.torque(TRUTH), before)


def test_a_peer_that_is_not_there_says_why(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(peer("jax"), "imports", ("json", "no_such_module", "no_such.module"))
    assert peer("jax").absent() == "no_such_module, no_such.module is not installed"
    assert Engine.absent(loop_of(EMPS)) is None
    monkeypatch.setattr("benchmarks.peers.c_stick.stick_folder", lambda: None)
    assert "beside the real records" in str(CStick.absent())
    monkeypatch.setattr("benchmarks.peers.c_stick.stick_folder", lambda: tmp_path)
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    assert CStick.absent() == "there is no gcc"
    monkeypatch.setattr(shutil, "which", lambda name: name)
    assert CStick.absent(loop_of(STICK)) is None
    assert CStick.absent(loop_of(EMPS)) == "it knows the stick's law only"


def test_everyone_takes_a_turn_in_every_round(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measuring, "_VISIT", 0.0)
    turns: list[str] = []
    times = measuring.interleaved({name: lambda name=name: turns.append(name) for name in "abc"}, 8)
    assert turns[:3] == ["a", "b", "c"]
    rounds = ["".join(turns[i : i + 3]) for i in range(3, 27, 3)]
    assert all(sorted(one) == ["a", "b", "c"] for one in rounds)
    assert len(set(rounds)) > 2
    assert all(seconds.shape == (8,) for seconds in times.values())


def test_the_fastest_setting_that_is_good_enough_is_chosen() -> None:
    labels = [setting.label for setting in peer("jax").settings]
    seconds = [Spread(s, s, s, 1) for s in (1.0, 3.0, 2.0)]
    points = [Point("jax", label, e, s) for label, e, s in zip(labels, (0.02, 0.009, 0.008), seconds, strict=False)]
    assert measuring.chosen(tuple(points), "jax").label == labels[2]
    worse = tuple(replace(point, error=10 * point.error) for point in points)
    assert measuring.chosen(worse, "jax").label == labels[2]
    assert measuring.chosen(worse[:2], "jax").label == labels[1]


def test_two_searches_end_at_one_minimum_and_count_what_they_run() -> None:
    axis = twin("L19")
    problem = identification.problem_of(axis)
    starts = identification.starts_of(problem, axis.truth, 3)
    assert np.array_equal(starts, identification.starts_of(problem, axis.truth, 5)[:3])
    ratio = starts / problem.vector(axis.truth)
    assert np.all((ratio > 1 / identification.FACTOR) & (ratio < identification.FACTOR))
    assert np.ptp(np.log(ratio)) > 1.0
    exact, by_differences = (
        identification.timed(search, problem, starts[0])
        for search in (identification.exact, identification.differences)
    )
    assert exact[2] == pytest.approx(0.08, abs=0.005)
    assert by_differences[2] == pytest.approx(exact[2], rel=1e-6)
    assert 5 < exact[1] < 60 < by_differences[1] < 600
    solver = identification.summed("both", [exact, by_differences, (1.0, 5, 0.3)], exact[2])
    assert solver.found == (True, True, False)


def test_the_toolbox_is_given_the_twin() -> None:
    axis = twin("L19")
    loop = mujoco_sysid.loop_of_twin(axis)
    problem = identification.problem_of(axis)
    expected = problem.torque(problem.vector(axis.truth | {"offset": 0.0}))
    parameters = np.array([axis.truth[name] for name in (p.name for p in problem.free) if name != "offset"])
    found = Engine(loop, Engine.settings[0]).torque(parameters)
    assert np.max(np.abs(found - expected)) <= 1e-8 * np.max(np.abs(expected))


def test_a_toolbox_that_is_not_there_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco_sysid, "_IMPORTS", ("numpy", "no_such_module"))
    axis = twin("L19")
    problem = identification.problem_of(axis)
    absent = mujoco_sysid.with_toolbox(axis, problem, np.empty((0, len(problem.free))), 0.08)
    assert (absent.starts, absent.note) == (0, "left out: no_such_module not installed")


def some_results() -> Results:
    """Results as small as they can be."""

    def timed(ms: float, ratio: float) -> Timed:
        return Timed(Spread(ms / 1e3, ms / 2e3, ms / 5e2, 7), Spread(ratio, ratio, ratio, 7))

    rows = (
        Row("jointid", "exact", 6e-12, timed(0.2, 1.0), timed(1.5, 1.0), timed(0.25, 1.0)),
        Row("jax", "2 steps, friction held", 0.006, timed(20.0, 100.0), timed(200.0, 133.0), timed(0.5, 2.0)),
    )
    loop = LoopResult(
        "stick", "the stick's loop", 25000, 230, 249.6, 8.0, rows, (("casadi", "casadi is not installed"),)
    )
    return Results(
        "a machine", (("Python", "3.11"),), "2026-01-01", (0.1, 5.5),
        tuple(Point(row.peer, row.setting, row.error, row.single.seconds) for row in rows),
        (loop,), Own(*[Spread(2e-4, 1e-4, 3e-4, 5)] * 3, 12.5, 0.5),
        (Footprint("nothing", spread([0.1, 0.1, 0.4]), 38.0), Footprint("jax", spread([1.0, 1.2]), 350.0)),
        (Size("JAX", 512.0, 8), Size("other", 0.0, 0, "it could not be installed: no")),
        (
            Solver("least squares", 6, (1.0,) * 6, (20,) * 6, (0.08,) * 6, (True,) * 4 + (False,) * 2),
            Solver("a toolbox", 0, (), (), (), (), "left out: no such thing"),
        ),
        Rigid(24841, Spread(0.03, 0.028, 0.04, 21), 7, 0.045),
        (Release("0.2.0", "2025-05-05", {"jax": (120.0, 9.0, 2.0)}),),
    ).of_release("0.3.0")  # fmt: skip


def test_the_page_says_what_was_measured() -> None:
    text = page.written(some_results())
    assert "| jointid | exact | 6e-10 % | 0.2 (0.1 to 0.4) | 1.00 | 1.5 (0.75 to 3) | 1.00 |" in text
    assert "| JAX scan | 2 steps, friction held | 0.6 % | 20 (10 to 40) | 100 | 200 (100 to 400) | 133 |" in text
    assert "| CasADi mapaccum | left out: casadi is not installed |" in text
    assert "| Python, NumPy and the problem | 0.10 (0.10 to 0.25) | 38 |" in text
    assert "before and after: 0.1 and 5.5." in text
    assert "| JAX | 512 | 8 |" in text
    assert "| other | it could not be installed: no |  |" in text
    assert "| least squares | 4 of 6 | 20 (20 to 20) | 1 (1 to 1) | 8.0000 |" in text
    assert "| a toolbox | left out: no such thing |" in text
    assert "takes 30 (28 to 40) ms and 7 simulations with derivatives, and leaves 4.50 % of the torque." in text
    assert "| release | measured | JAX scan |\n" in text
    assert "| 0.2.0 | 2025-05-05 | 120 |" in text
    assert "| 0.3.0 | 2026-01-01 | 100 |" in text
    assert [one.version for one in some_results().of_release("0.2.0").releases] == ["0.3.0", "0.2.0"]
    assert text.count("\n\n\n") == 0
    assert text.endswith(page.TRIED.read_text(encoding="utf-8"))
    assert "## Whole identifications" not in page.written(replace(some_results(), solvers=()))


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    results = some_results()
    save(results, tmp_path / "results.json")
    assert load(tmp_path / "results.json") == results


@pytest.mark.slow
def test_every_figure_of_the_page_is_drawn(tmp_path: Path) -> None:
    files = figures.drawn(some_results(), tmp_path)
    assert [path.name for path in files] == list(figures.IMAGES)
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in files)


def test_the_page_in_the_docs_is_that_of_its_data() -> None:
    docs = Path(__file__).resolve().parents[1] / "docs"
    assert (docs / "benchmarks.md").read_text(encoding="utf-8") == page.written(load(docs / "benchmarks.json"))
    assert all((docs / "images" / name).is_file() for name in figures.IMAGES)


def test_what_a_worker_spends_is_counted_from_its_first_end_to_its_last(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("7 10.0\n8 3.0\n7 10.5\n8 3.25\n7 11.0\n")
    assert core_seconds(log) == (1.25, 3)


def test_the_growth_of_cost_is_drawn_with_units() -> None:
    drawn = growth.Growth({6.25: 1e-4, 25.0: 3e-4}, {1: 4e-4, 10: 3e-3, 100: 0.03}, {1: 3e-4, 2: 3e-4})
    figure = growth.growth_figure(drawn)
    along = [axes.get_xlabel() for axes in figure.axes]
    assert along == ["length of a simulation [s]", "candidates of 25 s", "workers"]
    assert all(axes.get_ylabel().endswith("[ms]") for axes in figure.axes)
    assert "candidates   100    0.300 ms each" in str(drawn)
    assert "length  25.00 s    12.0 ns a sample" in str(drawn)
