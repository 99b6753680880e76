"""What a peer costs before it works: a fresh process up to its first torque, its memory, what is installed for it.

Run as a program, with a peer's key, this is that fresh process: it prints when it had its first torque, and the most
memory it held.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.results import Footprint, Size, spread

ROOT = Path(__file__).resolve().parents[1]
NOTHING = "nothing"
"""The key of a process that makes the problem and simulates nothing."""

_SHORT = 1000  # samples of the first simulation: start-up is measured, not speed


def footprints(settings: Mapping[str, int], rounds: int) -> tuple[Footprint, ...]:
    """Return start-up and memory of each peer, by its setting's number; in turn, in a new order every round."""
    random, keys = np.random.default_rng(0), [NOTHING, *settings]
    found: dict[str, list[tuple[float, float]]] = {key: [] for key in keys}
    for key in keys:
        _fresh(key, settings.get(key, 0))  # what is compiled once and kept, and files that are read from the disk
    for _ in range(rounds):
        for key in random.permutation(keys):
            found[key].append(_fresh(key, settings.get(key, 0)))
    return tuple(
        Footprint(key, spread([s for s, _ in runs]), float(np.median([m for _, m in runs])))
        for key, runs in found.items()
    )  # fmt: skip


def compiling() -> tuple[float, float]:
    """Return the seconds to this package's first torque ever, and to that of the next process, above all else's."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {"NUMBA_CACHE_DIR": cache}
        first, second = (_fresh("jointid", 0, environment)[0] for _ in range(2))
    return first, second


def sizes(title_and_requirements: Mapping[str, tuple[str, ...]]) -> tuple[Size, ...]:
    """Install each in an environment of its own and measure it; this fetches packages."""
    return tuple(_size(title, requirements) for title, requirements in title_and_requirements.items())


def _fresh(key: str, setting: int, environment: Mapping[str, str] | None = None) -> tuple[float, float]:
    """Return the seconds from the start of a process to its first torque, and its memory in MB."""
    begin = time.time()
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.footprint", key, str(setting)],
        cwd=ROOT, env={**os.environ, **(environment or {})}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    done, memory = json.loads(run.stdout.splitlines()[-1])
    return done - begin, memory


def _size(title: str, requirements: tuple[str, ...]) -> Size:
    uv = os.environ.get("UV") or shutil.which("uv")
    if uv is None:
        return Size(title, 0.0, 0, "uv is not there to make an environment with")
    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder)
        pins = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["uv"][
            "constraint-dependencies"
        ]
        (where / "pins.txt").write_text("\n".join(pins))
        clean = {name: value for name, value in os.environ.items() if name not in ("VIRTUAL_ENV", "PYTHONPATH")}
        install = [uv, "pip", "install", "-q", "--link-mode", "copy", "--no-compile-bytecode"]
        try:
            for command in (
                [uv, "venv", "-q", "--python", sys.executable, str(where / "env")],
                [*install, "--python", str(where / "env"), "-c", str(where / "pins.txt"), *requirements],
            ):
                subprocess.run(command, cwd=ROOT, env=clean, capture_output=True, text=True, check=True)
        except subprocess.CalledProcessError as error:
            return Size(title, 0.0, 0, f"it could not be installed: {error.stderr.strip().splitlines()[-1]}")
        (packages,) = (where / "env").glob("[Ll]ib/**/site-packages")
        files = sum(path.stat().st_size for path in packages.rglob("*") if path.is_file() and not path.is_symlink())
        return Size(title, files / 1e6, len(list(packages.glob("*.dist-info"))))


def _memory() -> float:
    """Return the most memory this process has held, MB."""
    status = Path("/proc/self/status")
    if status.is_file():  # the resource usage of a child begins with its parent's on Linux
        line = next(line for line in status.read_text(encoding="ascii").splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) * 1024 / 1e6
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def _first_torque(key: str, setting: int) -> None:
    from benchmarks.peers import peer
    from benchmarks.problem import STICK, TRUTH, loop_of

    loop = loop_of(STICK, _SHORT)
    if key != NOTHING:
        kind = peer(key)
        kind(loop, kind.settings[setting]).torque(TRUTH)
    print(json.dumps([time.time(), _memory()]))


if __name__ == "__main__":
    _first_torque(sys.argv[1], int(sys.argv[2]))
