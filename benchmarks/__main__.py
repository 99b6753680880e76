"""Measure everything and write docs/benchmarks.md, its figures and its data; see README.md."""

from __future__ import annotations

import argparse
import os
import platform
import re
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# As for the tests: matrices here are thousands of rows by ten columns, a second thread only waits for the first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.figures import drawn
from benchmarks.footprint import ROOT, footprints, sizes
from benchmarks.identification import STARTS, identified, rigid
from benchmarks.measuring import chosen, measured, own, swept
from benchmarks.page import written
from benchmarks.peers import PEERS, peer
from benchmarks.problem import LAWS, STICK, loop_of
from benchmarks.reference import reference_of
from benchmarks.results import Point, Results, load, save

DATA, PAGE, IMAGES = (ROOT / "docs" / name for name in ("benchmarks.json", "benchmarks.md", "images"))

_LIBRARIES = ("numpy", "scipy", "numba", "mujoco", "jax", "casadi", "control")
_INSTALLED = {
    "jointid": (".",),
    "SciPy": ("scipy",),
    "MuJoCo": ("mujoco",),
    "MuJoCo with its toolbox": ("mujoco[sysid]",),
    "JAX": ("jax",),
    "CasADi": ("casadi",),
    "python-control": ("control",),
}


def say(text: str) -> None:
    """Tell how far it is."""
    print(text, flush=True)


def measure(options: argparse.Namespace, before: Results | None) -> Results:
    """Return new results; what is not measured now is taken from before."""
    results = replace(before or Results("", (), ""), machine=_machine(), versions=_versions(), date=_today())
    loop, load_before = loop_of(STICK), _load()
    parts = options.only or ("loops", "start", "searches", *(("sizes",) if options.sizes else ()))
    points: tuple[Point, ...] = results.points
    if "loops" in parts:
        say("Every setting of every peer")
        points = swept(loop, reference_of(loop), say)
        results = replace(results, points=points, own=own(STICK, options.rounds))
        results = replace(results, loops=tuple(measured(law, points, options.rounds, say) for law in LAWS))
    if "start" in parts:
        say("Start-up and memory")
        keys = [key for key in PEERS if peer(key).absent(loop) is None]
        numbers = {key: peer(key).settings.index(chosen(points, key)) for key in keys}
        results = replace(results, footprints=footprints(numbers, options.rounds))
    if "searches" in parts:
        say("Whole identifications")
        results = replace(results, solvers=identified(options.starts, say), rigid=rigid())
    if "sizes" in parts:
        say("Install sizes")
        results = replace(results, sizes=sizes(_INSTALLED))
    return replace(results, load=(*load_before, *_load()))


def main() -> None:
    """Measure, keep, draw and write."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--rounds", type=int, default=7, help="in which everyone takes a turn")
    parser.add_argument("--starts", type=int, default=STARTS, help="of each search")
    parser.add_argument("--sizes", action="store_true", help="measure what installations take, too; this fetches them")
    parser.add_argument(
        "--only", nargs="+", choices=("loops", "start", "searches", "sizes"), help="measure these; keep the rest"
    )
    parser.add_argument("--page", action="store_true", help="measure nothing; write the page again")
    options = parser.parse_args()
    before = load(DATA) if DATA.is_file() else None
    if options.page:
        if before is None:
            parser.error(f"there are no results in {DATA.name}: run it without --page first")
        results = before
    else:
        results = measure(options, before).of_release(version("jointid"))
        save(results, DATA)
    for path in (*drawn(results, IMAGES), _page(results)):
        say(f"wrote {path.relative_to(ROOT)}")


def _page(results: Results) -> Path:
    PAGE.write_text(written(results), encoding="utf-8")
    return PAGE


def _machine() -> str:
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text(encoding="utf-8")) if info.is_file() else None
    name = found.group(1) if found else platform.processor() or platform.machine()
    return f"{name}, {os.cpu_count()} cores, {platform.system()}"


def _load() -> tuple[float, ...]:
    return os.getloadavg()[:1] if hasattr(os, "getloadavg") else ()


def _versions() -> tuple[tuple[str, str], ...]:
    found = [("Python", platform.python_version())]
    for name in _LIBRARIES:
        try:
            found.append((name, version(name)))
        except PackageNotFoundError:
            found.append((name, "not installed"))
    return tuple(found)


def _today() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%d")


if __name__ == "__main__":
    main()
