"""Times that can be compared on a shared machine: everyone in turn, in a new order every round."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from benchmarks.peers import PEERS, Setting, peer
from benchmarks.peers.engine import Engine
from benchmarks.problem import SAMPLES, TRUTH, Array, Law, Loop, candidates, loop_of
from benchmarks.reference import Reference, reference_of
from benchmarks.results import LoopResult, Own, Point, Row, Spread, Timed, spread

ENOUGH = 0.01
"""The worst torque error, as a share of the peak, that the setting in the tables may have."""

_VISIT = 0.03  # s: a call that is shorter is repeated, and the visit counts as its mean
_SWEEPS = 5  # rounds that the settings are compared in
_OURS = Engine.key

Call = Callable[[], object]
Say = Callable[[str], None]


def interleaved(calls: Mapping[str, Call], rounds: int, seed: int = 0) -> dict[str, Array]:
    """Return the seconds of every call in every round, (rounds,); each is called once before."""
    random = np.random.default_rng(seed)
    names, times = list(calls), {name: np.empty(rounds) for name in calls}
    for call in calls.values():
        call()
    for i in range(rounds):
        for name in random.permutation(names):
            times[name][i] = _visit(calls[name])
    return times


def _visit(call: Call) -> float:
    begin, count = time.perf_counter(), 0
    while True:
        call()
        count += 1
        if (passed := time.perf_counter() - begin) > _VISIT:
            return passed / count


def swept(loop: Loop, reference: Reference, say: Say) -> tuple[Point, ...]:
    """Return error and time of every setting of every peer that is here."""
    errors: dict[tuple[str, str], float] = {}
    calls: dict[str, Call] = {}
    for key in PEERS:
        kind = peer(key)
        if reason := kind.absent(loop):
            say(f"  {key}: {reason}")
            continue
        for setting in kind.settings:
            made = kind(loop, setting)
            errors[key, setting.label] = reference.error(made.torque(TRUTH))
            calls[f"{key}|{setting.label}"] = lambda made=made: made.torque(TRUTH)  # type: ignore[misc]
            say(f"  {key}, {setting.label}: worst torque error {100 * errors[key, setting.label]:.2g} % of the peak")
    times = interleaved(calls, _SWEEPS)
    return tuple(
        Point(key, label, error, spread(times[f"{key}|{label}"])) for (key, label), error in errors.items()
    )  # fmt: skip


def chosen(points: tuple[Point, ...], key: str) -> Setting:
    """Return a peer's fastest setting that errs by no more than `ENOUGH`; where none is so good, its best."""
    own = [point for point in points if point.peer == key]
    good = [point for point in own if point.error <= ENOUGH]
    best = min(good, key=lambda p: p.seconds.median) if good else min(own, key=lambda p: p.error)
    return next(setting for setting in peer(key).settings if setting.label == best.setting)


def measured(law: Law, points: tuple[Point, ...], rounds: int, say: Say) -> LoopResult:
    """Return all peers on one loop, each in its chosen setting."""
    loop = loop_of(law)
    begin = time.perf_counter()
    reference = reference_of(loop)
    took = time.perf_counter() - begin
    absent = tuple((key, reason) for key in PEERS if (reason := peer(key).absent(loop)))
    settings = {key: chosen(points, key) for key in PEERS if key not in dict(absent)}
    errors, single, slopes, batch = {}, {}, {}, {}
    scales = {"slopes": {}, "batch": {}}  # type: dict[str, dict[str, float]]
    for key, setting in settings.items():
        kind = peer(key)
        whole, part = kind(loop, setting), kind(loop.first(kind.slow), setting)
        many = candidates(kind.batch_size)
        errors[key] = reference.error(whole.torque(TRUTH))
        single[key] = _bound(whole.torque, TRUTH)
        slopes[key], batch[key] = _bound(part.slopes, TRUTH), _bound(part.batch, many)
        scales["slopes"][key] = SAMPLES / kind.slow
        scales["batch"][key] = SAMPLES / kind.slow / kind.batch_size
    times = {}
    for name, calls in {"single": single, "slopes": slopes, "batch": batch}.items():
        say(f"  {law.title}: {name}, {rounds} rounds")
        found = interleaved(calls, rounds)
        times[name] = {key: found[key] * scales.get(name, {}).get(key, 1.0) for key in calls}
    rows = tuple(
        Row(key, setting.label, errors[key], *(_timed(times[name], key) for name in ("single", "slopes", "batch")))
        for key, setting in settings.items()
    )
    return LoopResult(
        law.key, law.title, loop.samples, reference.events, reference.peak, took, rows, absent,
        _differences(loop, reference),
    )  # fmt: skip


def own(law: Law, rounds: int) -> Own:
    """Return what only this package is asked."""
    from benchmarks.footprint import compiling

    engine = Engine(loop_of(law), Engine.settings[0])
    many = candidates(Engine.batch_size)
    times = interleaved(
        {
            "kernel": engine.kernel(TRUTH),
            "single": lambda: engine.torque(TRUTH),
            "one core": lambda: engine.batch(many, workers=1),
        },
        rounds,
    )
    return Own(spread(times["kernel"]), spread(times["single"]), _each(times["one core"], len(many)), *compiling())


def _each(seconds: Array, count: int) -> Spread:
    return spread(seconds / count)


def _bound(call: Callable[[Array], Any], argument: Array) -> Call:
    return lambda: call(argument)


def _timed(times: Mapping[str, Array], key: str) -> Timed:
    return Timed(spread(times[key]), spread(times[key] / times[_OURS]))


def _differences(loop: Loop, reference: Reference) -> tuple[tuple[str, float], ...]:
    """Return how far the stick's C and its own reference are from this reference and this package."""
    from benchmarks.peers.c_stick import CStick, stick_module

    if CStick.absent(loop):
        return ()
    theirs = CStick(loop, CStick.settings[0]).torque(TRUTH)
    ours = Engine(loop, Engine.settings[0]).torque(TRUTH)
    stick = stick_module("ref").run()[0]
    return (
        ("jointid and the C version", float(np.max(np.abs(ours - theirs))) / reference.peak),
        ("this reference and the stick's", reference.error(stick)),
    )
