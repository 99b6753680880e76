"""One closed loop of 25 s at 1 kHz, by this package and by what one would use instead: error, times and ratios.

    python -m benchmarks [--rounds 7]

Everyone runs in turn on the same machine, in a new order every round; what counts are the ratios. Speed at another
error is not the same thing: beside the times stands the worst torque error, against an event-driven reference.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from benchmarks.peers import PEERS, Peer, peer
from benchmarks.problem import SAMPLES, STICK, TRUTH, Array, loop_of
from benchmarks.reference import reference_of

ENOUGH = 0.01
"""The worst torque error, as a share of the peak, that the setting in the table may have."""

_VISIT = 0.03  # s: a call that is shorter is repeated, and the visit counts as its mean


def interleaved(calls: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, Array]:
    """Return the seconds of every call in every round, (rounds,); each is called once before."""
    random = np.random.default_rng(0)
    names, times = list(calls), {name: np.empty(rounds) for name in calls}
    for call in calls.values():
        call()
    for i in range(rounds):
        for name in random.permutation(names):
            times[name][i] = _visit(calls[name])
    return times


def _visit(call: Callable[[], object]) -> float:
    begin, count = time.perf_counter(), 0
    while True:
        call()
        count += 1
        if (passed := time.perf_counter() - begin) > _VISIT:
            return passed / count


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    loop = loop_of(STICK)
    reference = reference_of(loop)
    print(
        f"{loop.samples:,} samples, {reference.events} stops, starts and reversals, {reference.peak:.0f} N at the peak"
    )
    chosen: dict[str, tuple[Peer, float]] = {}
    for key in PEERS:
        kind = peer(key)
        if reason := kind.absent():
            print(f"{kind.title}: left out, {reason}")
            continue
        for setting in kind.settings:  # from fast to exact
            made = kind(loop, setting)
            chosen[key] = made, reference.error(made.torque(TRUTH))
            if chosen[key][1] <= ENOUGH:
                break
    single = interleaved({key: partial(one.torque, TRUTH) for key, (one, _) in chosen.items()}, rounds)
    parts = {key: type(one)(loop.first(one.slow), one.setting) for key, (one, _) in chosen.items()}
    slopes = interleaved({key: partial(one.slopes, TRUTH) for key, one in parts.items()}, rounds)
    slopes = {key: seconds * SAMPLES / parts[key].slow for key, seconds in slopes.items()}
    print("| | setting | worst error | one simulation, ms | ratio | with 8 derivatives, ms | ratio |")
    print("|---|---|---|---|---|---|---|")
    for key, (made, error) in chosen.items():
        cells = [made.title, made.setting.label, f"{100 * error:.1g} %"]
        for times in (single, slopes):
            ratio = np.median(times[key] / times[PEERS[0]])
            cells += [f"{1e3 * np.median(times[key]):.3g}", f"{ratio:.2f}" if ratio < 10 else f"{ratio:,.0f}"]
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
