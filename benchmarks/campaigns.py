"""Campaigns, measured: `python -m benchmarks.campaigns`; `--runs` and `--simulations` shorten it, `--figure` draws.

How many identifications of the twin two workers make against one process that knows no campaign, what handing them out
costs, whether memory grows, and whether processes, a Dask cluster that loses a worker and gets another, and shards give
the same bytes. Then how many simulations of 25 s a core makes beside the C stick, and how their cost grows with length,
candidates and workers. All are ratios of one run.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["JOINTID_THREADS"] = "1"

import jointid as ji
from benchmarks.clocked import clocked, core_seconds
from benchmarks.dask_cluster import Cluster
from benchmarks.growth import growth_figure, measure
from benchmarks.peers import peer
from benchmarks.peers.c_stick import stick_folder
from benchmarks.problem import STICK, candidates, loop_of
from jointid.campaigns.campaign_file import Campaign, load_campaign
from jointid.campaigns.cases import Case, Row
from jointid.campaigns.engines import DaskCluster, Engine, LocalProcesses, on_one_core
from jointid.campaigns.folder import read_results
from jointid.campaigns.report import export_rows
from jointid.campaigns.run import run_case, run_cases
from jointid.campaigns.shards import Shard, open_shard
from jointid.campaigns.store import open_database
from jointid.paper.twin import JOINT_FILE, TABLE_2

_SHARDS, _WORKERS = 4, 2
_TURNS = 6
_AT_A_TIME = 500  # simulations whose torques are kept


def twin_campaign(folder: Path, runs: int) -> Campaign:
    """Write a campaign of noisy runs of the flexible twin."""
    ji.write(ji.twin(noise="none").record, folder / "record.csv")
    (folder / "joint.toml").write_text(JOINT_FILE, encoding="utf-8")
    values = "".join(f"{name} = {value!r}\n" for name, value in TABLE_2.items())
    text = f'[monte_carlo]\njoint = "joint.toml"\nruns = {runs}\nnoise_force = 9.83\n[monte_carlo.values]\n{values}'
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return load_campaign(folder / "campaign.toml")


def identifications(folder: Path, runs: int) -> None:
    """Print the pace of every engine beside that of one process without a campaign, and whether the bytes agree."""
    campaign = twin_campaign(folder, runs)
    alone = min(runs, 100)
    on_one_core(run_case, list(islice(campaign.cases(), 1)))  # loads and, the first time, compiles
    carried(folder / "first", LocalProcesses(_WORKERS), list(islice(campaign.cases(), 4)))
    compare(folder, list(islice(campaign.cases(), alone)))
    cases, names = list(campaign.cases()), ["processes"]
    print_pace("processes", runs, carried(folder / "processes", LocalProcesses(_WORKERS), cases))
    if find_spec("distributed") is None:
        print(f"{'dask':14} not there: pip install jointid[cluster]")
    else:
        with contextlib.ExitStack() as stack:
            cluster = Cluster(folder, stack)
            first, _ = cluster.add_worker(), cluster.add_worker()

            def come_and_go() -> None:
                first.kill()
                cluster.add_worker()

            seconds = carried(folder / "dask", DaskCluster(cluster.address), cases, come_and_go)
        print_pace("dask", runs, seconds)
        print(f"{'':14} of two workers one was killed midway, and one added")
        names.append("dask")
    begin = time.perf_counter()
    for number in range(_SHARDS):
        part = Shard(number + 1, _SHARDS)
        (folder / "shards").mkdir(exist_ok=True)
        with open_shard(folder / "shards", part) as results:
            run_cases(campaign.cases, LocalProcesses(_WORKERS), results, has=part.has)
    print_pace(f"{_SHARDS} shards", runs, time.perf_counter() - begin)
    tables = {}
    for name in [*names, "shards"]:
        export_rows(read_results(folder / name).rows, folder / f"{name}.csv")
        tables[name] = (folder / f"{name}.csv").read_bytes()
    same = len(set(tables.values())) == 1
    print(f"the same {len(next(iter(tables.values())))} bytes by {', '.join(tables)}: {'yes' if same else 'NO'}")


def compare(folder: Path, cases: list[Case]) -> None:
    """Print the pace of one process without a campaign, one of a campaign and two, by turns, and what a case costs.

    Seconds of a core are those of the workers and of the client. Others that use the machine change the pace and much
    less these.
    """
    names = ("no campaign", "1 process", f"{_WORKERS} processes")
    took, spent = (dict.fromkeys(names, 0.0) for _ in range(2))
    turns = min(_TURNS, len(cases) // (2 * _WORKERS))
    for turn in range(turns):
        part = cases[turn * len(cases) // turns : (turn + 1) * len(cases) // turns]
        for name in names[turn % len(names) :] + names[: turn % len(names)]:
            log, begin, own = folder / f"{name}-{turn}.log", time.perf_counter(), time.process_time()
            if name == names[0]:
                on_one_core(run_case, part)
                took[name] += time.perf_counter() - begin
                spent[name] += time.process_time() - own
            else:
                workers = 1 if name == names[1] else _WORKERS
                took[name] += carried(
                    folder / f"{name}-{turn}", LocalProcesses(workers), part, carry=partial(clocked, log)
                )
                seconds, number = core_seconds(log)
                spent[name] += len(part) * seconds / number + time.process_time() - own
    for name in names:
        print(
            f"{name:14} {len(cases) / took[name]:6.2f}/s, {took[names[0]] / took[name]:5.2f} of no campaign; "
            f"{spent[name] / len(cases):.3f} s of a core each, {100 * (spent[name] / spent[names[0]] - 1):+.1f} % "
            f"({len(cases)} identifications, by turns)"
        )


def print_pace(name: str, runs: int, seconds: float) -> None:
    """Print identifications a second."""
    print(f"{name:14} {runs / seconds:6.2f}/s  {runs} identifications")


def carried(
    folder: Path,
    engine: Engine,
    cases: list[Case],
    midway: Callable[[], None] | None = None,
    carry: Callable[[Case], Row] = run_case,
) -> float:
    """Carry out cases, and return the seconds it takes when the workers have started.

    Args:
        folder: is made.
        engine: who carries them out.
        cases: one or more.
        midway: is called once, when half of them are done.
        carry: what a worker does with a case.
    """
    folder.mkdir()
    memory: list[int] = []
    begin = time.perf_counter()

    with open_database(folder) as database:
        keep, done = database.add, list[float]()

        def add(rows: Sequence[Row]) -> None:
            keep(rows)
            done.append(time.perf_counter())
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
            if midway is not None and len(done) == (len(cases) + 1) // 2:
                midway()

        database.add = add  # type: ignore[method-assign]
        run_cases(lambda: cases, engine, database, carry=carry)
    if len(memory) > 100:
        quarter = memory[len(memory) // 4]
        print(f"{'':14} memory of the client {memory[-1] / 1024:.0f} MB, {memory[-1] / quarter:.3f} of a quarter's")
    workers = getattr(engine, "workers", _WORKERS) or _WORKERS
    if len(done) <= workers:  # too few to leave the start of the workers out
        return done[-1] - begin
    # From when each worker had given a result to the last, and as much for those first ones.
    return (done[-1] - done[workers - 1]) * len(done) / (len(done) - workers)


def simulations(count: int) -> None:
    """Print simulations of 25 s a second, beside the C stick."""
    kinds = ["jointid", *(["c"] if stick_folder() is not None else [])]
    loop = loop_of(STICK)
    made = {key: peer(key)(loop, peer(key).settings[0]) for key in kinds}
    spent = dict.fromkeys(kinds, 0.0)
    every = candidates(_AT_A_TIME)
    for key in kinds:
        made[key].batch(every[:50])
    for _ in range(max(count // _AT_A_TIME, 1)):
        for key in kinds:
            begin = time.perf_counter()
            made[key].batch(every)
            spent[key] += time.perf_counter() - begin
    total = max(count // _AT_A_TIME, 1) * _AT_A_TIME
    for key in kinds:
        ratio = f", {spent['c'] / spent[key]:.2f} of the stick's" if "c" in kinds else ""
        print(f"{key:14} {total / spent[key]:8.0f} simulations of 25 s a second on {_WORKERS} cores{ratio}")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaigns", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="identifications")
    parser.add_argument("--simulations", type=int, default=100_000, help="of 25 s")
    parser.add_argument("--figure", type=Path, help="draw how the cost of simulations grows, as PNG, SVG or PDF")
    options = parser.parse_args()
    if options.simulations:
        simulations(options.simulations)
        growth = measure()
        print(growth)
        if options.figure is not None:
            growth_figure(growth).savefig(options.figure, dpi=130)
    if options.runs:
        with tempfile.TemporaryDirectory() as folder:
            identifications(Path(folder), options.runs)


if __name__ == "__main__":
    main()
