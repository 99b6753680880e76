"""The page docs/benchmarks.md, made from the results alone; what is told in words is here, what was measured is not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from benchmarks.figures import IMAGES, LEFT
from benchmarks.footprint import NOTHING
from benchmarks.identification import FACTOR
from benchmarks.measuring import ENOUGH
from benchmarks.peers import PEERS, peer
from benchmarks.problem import EMPS, SAMPLES, STICK
from benchmarks.results import LoopResult, Release, Results, Rigid, Solver, Spread, Timed, spread
from benchmarks.searching import SAME

TRIED = Path(__file__).with_name("tried.md")
"""What was tried, measured and left out; kept by hand, a line for each."""

_HEAD = """\
# How fast it is

One closed loop of 25 s at 1 kHz, two masses on a spring with Coulomb friction under a sampled law, by this package and
by what one would use instead. What counts are the ratios: everyone runs in turn on the same machine, in a new order
every round; times are medians, with the quartiles of the rounds in brackets, and a ratio is the median of those of the
rounds. A shared machine is slow now and then; nothing about time is asserted in the tests. Speed at another error is
not the same thing: beside every time stands the worst torque error, against an event-driven reference.

The measuring stick is a plain C version of the same exact simulation, with a law and a friction of its own. It lies
beside the real records and outside the project; where it is not there its row says so.

This page is written by one command, from `docs/benchmarks.json`, where everything it measured is kept. What a run is
told not to measure (`--only`) stays as it was: on another machine, measure all.

<!-- not run: half an hour -->
```sh
python3 -m uv run --group bench python -m benchmarks
```
"""


_LAWS = {
    STICK.key: "A stiff PD law, with the reference's velocity and a filter of first order on the measured one.",
    EMPS.key: "The same joint and motion under the cascade of the public EMPS axis: 18 Hz on this mass.",
}


def written(results: Results) -> str:
    """Return the page."""
    parts = [_HEAD, _machine(results)]
    parts += [_loop(loop) for loop in results.loops]
    if results.loops:
        parts.append(f"![Times of one simulation, with derivatives, and in a batch](images/{IMAGES[1]})\n")
    parts += _errors(results)
    parts.append(_means(results))
    parts += _own(results)
    parts += _before(results)
    parts += _searches(results.solvers, results.rigid)
    parts += _releases(results.releases)
    parts.append(TRIED.read_text(encoding="utf-8"))
    return "\n".join(part.strip("\n") + "\n" for part in parts if part)


def _machine(results: Results) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in results.versions)
    lines = [f"Measured on {results.date}: {results.machine}; {versions}. One thread of linear algebra."]
    if results.load:
        lines.append(
            f"Load average before and after: {' and '.join(f'{load:.1f}' for load in results.load)}. "
            "Above one, other processes were running, and timings on two cores suffer most."
        )
    return " ".join(lines)


def _loop(loop: LoopResult) -> str:
    lines = [
        f"## One simulation: {loop.title}\n",
        f"{_LAWS.get(loop.law, '')}\n",
        f"{loop.samples:,} samples, {loop.events} stops, starts and reversals, {loop.peak:.0f} N at the peak. The "
        f"reference (DOP853 at 1e-12, every event located) took {loop.seconds:.0f} s.\n",
        *_table(
            ("", "setting", "worst error", "one simulation, ms", "ratio", "with 8 derivatives, ms", "ratio",
             "each of 1,000 on two cores, ms", "ratio"),
            [
                (
                    peer(row.peer).title, row.setting, _percent(row.error),
                    *(cell for timed in (row.single, row.slopes, row.batch) for cell in _timed(timed)),
                )
                for row in loop.rows
            ] + [(peer(key).title, f"left out: {reason}", *[""] * 7) for key, reason in loop.absent],
        ),
    ]  # fmt: skip
    if loop.differences:
        told = "; ".join(f"{what} differ by {share:.1e} of the peak" for what, share in loop.differences)
        lines.append(f"\nThe largest differences: {told}.\n")
    return "\n".join(lines)


def _errors(results: Results) -> list[str]:
    if not results.points:
        return []
    rows = [
        (peer(p.peer).title, p.setting, _percent(p.error), _ms(p.seconds))
        for key in PEERS for p in results.points if p.peer == key
    ]  # fmt: skip
    return [
        "## Error against time\n",
        "Each peer is asked in several ways, on the first loop. In the tables above stands the fastest that errs by at "
        f"most {100 * ENOUGH:g} % of the peak, or where none does, the one that errs least. In the figure "
        f"what errs by less than {LEFT:g} % stands at the left edge.\n",
        f"![Time of a simulation against its worst torque error](images/{IMAGES[0]})\n",
        "\n".join(_table(("", "setting", "worst error", "one simulation, ms"), rows)),
    ]


def _means(results: Results) -> str:
    keys = [row.peer for loop in results.loops[:1] for row in loop.rows]
    rows = [(k.title, k.model, k.derivatives, k.many, _scaled(k.slow, k.batch_size)) for k in map(peer, keys)]
    lines = _table(("", "what it does", "derivatives", "batch of 1,000", "measured on"), rows)
    return "\n".join(["## What each of them does\n", *lines]) if rows else ""


def _own(results: Results) -> list[str]:
    if results.own is None:
        return []
    own = results.own
    whole = own.single.median / own.kernel.median
    return [
        "## Inside jointid\n",
        f"- The compiled kernel alone takes {_ms(own.kernel)} ms, what an optimiser calls (named parameters in, the "
        f"torque as logged out) {_ms(own.single)} ms: {whole:.2f} times as long.\n"
        f"- Each of 1,000 candidates takes {_ms(own.one_core)} ms on one core; every torque is kept, in fresh memory.\n"
        f"- The first simulation ever compiles: {own.compiling:.1f} s from the start of the process to its torque. "
        f"With the compiler's cache filled it is {own.cached:.1f} s.\n",
    ]


def _before(results: Results) -> list[str]:
    parts = []
    if results.footprints:
        rows = [
            ("Python, NumPy and the problem" if f.peer == NOTHING else peer(f.peer).title,
             f"{f.seconds.median:.2f} ({f.seconds.low:.2f} to {f.seconds.high:.2f})", f"{f.memory:.0f}")
            for f in results.footprints
        ]  # fmt: skip
        parts += [
            "## Before the first torque\n",
            "From the start of a fresh process to the first torque of a record of one second, what was compiled once "
            "for all in its cache (for C and CasADi gcc runs every time, and JAX compiles again); and the most memory "
            "the process held.\n",
            "\n".join(_table(("", "start-up, s", "memory, MB"), rows)),
        ]
    if results.sizes:
        rows = [
            (s.title, s.failed or f"{s.megabytes:.0f}", "" if s.failed else str(s.distributions)) for s in results.sizes
        ]
        parts += [
            "What an installation takes, with all it depends on, in an environment of its own, without bytecode:\n",
            "\n".join(_table(("", "MB", "distributions"), rows)),
        ]
    return parts


def _searches(solvers: Sequence[Solver], rigid: Rigid | None) -> list[str]:
    if not solvers:
        return []
    absent = [(solver.title, solver.note, "", "", "") for solver in solvers if not solver.starts]
    rows = [
        (
            solver.title + (f" ({solver.note})" if solver.note else ""),
            f"{sum(solver.found)} of {solver.starts}",
            _whole(spread(solver.simulations)),
            _seconds(spread(solver.seconds)),
            f"{100 * min(solver.left):.4f}",
        )
        for solver in solvers
        if solver.starts
    ]
    tries = max(solver.starts for solver in solvers)
    return [
        "## Whole identifications\n",
        f"The paper's flexible axis from torque alone, nine parameters, on its digital twin (24 s, 8 % of the torque "
        f"unexplained), from the same {tries} starts, every parameter at random within a factor of {FACTOR:g} of the "
        "truth. A start counts as successful when it ends at the lowest minimum that any search found, to "
        f"{100 * SAME:g} % of the criterion. A simulation with exact derivatives counts as one.\n",
        "\n".join(_table(("", "successful", "simulations", "time, s", "least left of the torque, %"), rows + absent)),
        f"\n![Starts that found the minimum, over time and simulations](images/{IMAGES[2]})\n",
        *_rigid(rigid),
    ]


def _releases(releases: Sequence[Release]) -> list[str]:
    if not releases:
        return []
    peers = [key for key in PEERS if key != "jointid" and any(key in one.ratios for one in releases)]
    rows = [
        (one.version, one.date, *(f"{one.ratios[key][0]:,.3g}" if key in one.ratios else "" for key in peers))
        for one in releases
    ]
    return [
        "## Over the releases\n",
        "How many times as long as jointid each peer takes for one simulation of the first loop, a row for each "
        "release. A ratio is measured side by side on one machine, so that rows compare although machines differ.\n",
        f"![Ratios to the peers over the releases](images/{IMAGES[3]})\n",
        "\n".join(_table(("release", "measured", *(peer(key).title for key in peers)), rows)),
    ]


def _rigid(found: Rigid | None) -> list[str]:
    if found is None:
        return []
    return [
        f"`identify` takes the public EMPS record, {found.samples:,} samples of a real rigid axis, with its joint "
        "file, from torque alone. Intervals and verdicts included, a repeated call in one process takes "
        f"{_ms(found.seconds)} ms and {found.simulations} simulations with derivatives, and leaves "
        f"{100 * found.left:.2f} % of the torque.\n"
    ]


def _table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows)]


def _timed(timed: Timed) -> tuple[str, str]:
    ratio = timed.ratio.median
    return _ms(timed.seconds), f"{ratio:.2f}" if ratio < 10 else f"{ratio:,.0f}"


def _ms(seconds: Spread) -> str:
    low, middle, high = (_digits(1e3 * value) for value in (seconds.low, seconds.median, seconds.high))
    return f"{middle} ({low} to {high})"


def _seconds(seconds: Spread) -> str:
    if seconds.count < 2:
        return _digits(seconds.median)
    return f"{_digits(seconds.median)} ({_digits(seconds.low)} to {_digits(seconds.high)})"


def _whole(counts: Spread) -> str:
    if counts.count < 2:
        return f"{counts.median:,.0f}"
    return f"{counts.median:,.0f} ({counts.low:,.0f} to {counts.high:,.0f})"


def _digits(value: float) -> str:
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _percent(share: float) -> str:
    return f"{100 * share:.0e} %" if share < 1e-6 else f"{100 * share:.2g} %"


def _scaled(samples: int, candidates: int) -> str:
    told = [] if samples == SAMPLES else [f"derivatives and batch on {samples:,} samples"]
    told += [] if candidates == 1000 else [f"a batch of {candidates}"]
    return f"{' and '.join(told)}, scaled" if told else "all of it"
