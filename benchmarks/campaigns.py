"""Campaigns, measured: `python -m benchmarks.campaigns`; `--runs` and `--simulations` make it shorter or longer.

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
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["JOINTID_THREADS"] = "1"

import jointid as ji
from benchmarks.dask_cluster import Cluster
from benchmarks.peers import peer
from benchmarks.peers.c_stick import stick_folder
from benchmarks.problem import SAMPLES, STICK, candidates, loop_of
from jointid.campaigns.campaign_file import Campaign, load_campaign
from jointid.campaigns.cases import Case
from jointid.campaigns.engines import DaskCluster, Engine, LocalProcesses, on_one_core
from jointid.campaigns.export import export_rows
from jointid.campaigns.folder import read_results
from jointid.campaigns.rows import Row
from jointid.campaigns.run import run_cases
from jointid.campaigns.run_case import run_case
from jointid.campaigns.shards import Shard, open_shard
from jointid.campaigns.store import open_database
from jointid.paper.twin import JOINT_FILE, TABLE_2

_SHARDS, _WORKERS = 4, 2
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
    # By turns, as others use the machine too: what it is to one it is to all.
    turns = min(4, alone)
    paces: dict[str, list[float]] = {"no campaign": [], "1 process": [], f"{_WORKERS} processes": []}
    for turn in range(turns):
        part = list(islice(campaign.cases(), turn * alone // turns, (turn + 1) * alone // turns))
        begin = time.perf_counter()
        on_one_core(run_case, part)
        paces["no campaign"].append(len(part) / (time.perf_counter() - begin))
        for name, workers in (("1 process", 1), (f"{_WORKERS} processes", _WORKERS)):
            seconds = carried(folder / f"{workers}-{turn}", LocalProcesses(workers), part)
            paces[name].append(len(part) / seconds)
    one = sum(paces["no campaign"]) / turns
    for name, found in paces.items():
        pace = sum(found) / turns
        print(f"{name:14} {pace:6.2f}/s  {pace / one:5.2f} of no campaign ({alone} identifications, by turns)")
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


def print_pace(name: str, runs: int, seconds: float) -> None:
    """Print identifications a second."""
    print(f"{name:14} {runs / seconds:6.2f}/s  {runs} identifications")


def carried(folder: Path, engine: Engine, cases: list[Case], midway: Callable[[], None] | None = None) -> float:
    """Carry out cases, and return the seconds it takes when the workers have started.

    Args:
        folder: is made.
        engine: who carries them out.
        cases: one or more.
        midway: is called once, when half of them are done.
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
        run_cases(lambda: cases, engine, database)
    if len(memory) > 100:
        quarter = memory[len(memory) // 4]
        print(f"{'':14} memory of the client {memory[-1] / 1024:.0f} MB, {memory[-1] / quarter:.3f} of a quarter's")
    workers = getattr(engine, "workers", _WORKERS) or _WORKERS
    if len(done) <= workers:  # too few to leave the start of the workers out
        return done[-1] - begin
    # From when each worker had given a result to the last, and as much for those first ones.
    return (done[-1] - done[workers - 1]) * len(done) / (len(done) - workers)


def simulations(count: int) -> None:
    """Print simulations of 25 s a second, beside the C stick, and how cost grows."""
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
    for samples in (SAMPLES // 4, SAMPLES, 4 * SAMPLES):
        engine = peer("jointid")(loop_of(STICK, samples), peer("jointid").settings[0])
        engine.batch(every[:20])
        begin = time.perf_counter()
        engine.batch(every[:200])
        print(f"length {samples / 1000:6.1f} s  {1e9 * (time.perf_counter() - begin) / 200 / samples:7.1f} ns a sample")
    for number in (10, 100, 1000):
        begin = time.perf_counter()
        for _ in range(1000 // number):
            made["jointid"].batch(candidates(number))
        print(f"candidates {number:5}  {1e3 * (time.perf_counter() - begin) / (1000 // number * number):7.3f} ms each")
    for workers in (1, 2):
        begin = time.perf_counter()
        made["jointid"].batch(every, workers)  # type: ignore[call-arg]
        print(f"workers {workers}  {_AT_A_TIME / (time.perf_counter() - begin):8.0f} simulations of 25 s a second")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaigns", description=__doc__)
    parser.add_argument("--runs", type=int, default=1000, help="identifications")
    parser.add_argument("--simulations", type=int, default=100_000, help="of 25 s")
    options = parser.parse_args()
    if options.simulations:
        simulations(options.simulations)
    if options.runs:
        with tempfile.TemporaryDirectory() as folder:
            identifications(Path(folder), options.runs)


if __name__ == "__main__":
    main()
