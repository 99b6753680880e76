"""How long one closed loop takes, beside a plain C version of it and SciPy's solve_ivp; see README.md."""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import scipy
from scipy.integrate import solve_ivp

from jointid.data.record import Channel, Injection, InjectionPoint, Record
from jointid.model.controllers import PD, DigitalFilter
from jointid.model.joints import FlexibleJoint
from jointid.simulation import kernels
from jointid.simulation.closed_loop import simulate_many, simulate_torque
from jointid.simulation.experiment import ClosedLoop, Experiment, prepare
from jointid.simulation.sensitivities import simulate_sensitivities

HERE = Path(__file__).resolve().parent
BATCH = 64  # candidates
STRETCH = 3000  # samples that solve_ivp is given
MARKS = ("<!-- table -->", "<!-- /table -->")


def bench_dir() -> Path | None:
    """The folder of the measuring stick, found as the tests find it."""
    named = os.environ.get("JOINTID_DATA")
    places = [Path(named)] if named else []
    places.append(HERE.parents[1] / "shared" / "data")
    return next((p.parent / "bench" for p in places if (p.parent / "bench" / "stick.py").is_file()), None)


def our_loop(problem: dict[str, Any]) -> tuple[ClosedLoop, Experiment, dict[str, float]]:
    """The stick's problem in our words."""
    gains, period = problem["controller"], problem["sample_time"]
    alpha = gains["alpha"]
    controller = PD(
        kp=gains["kp"], kd=gains["kd"], reference_velocity="channel",
        velocity_filter=DigitalFilter((1 - alpha,), (1, -alpha)), limit=gains["umax"],
    )  # fmt: skip
    driven = Record(
        reference=Channel(problem["reference"], "m", period),
        reference_velocity=Channel(problem["reference_velocity"], "m/s", period),
        injected=Injection(Channel(problem["pulse"], "N", period), InjectionPoint.BEFORE_LIMIT),
    )
    loop = ClosedLoop(FlexibleJoint(), controller)
    values = dict(zip([p.name for p in loop.joint.parameters], [*map(float, problem["parameters"]), 0.0], strict=True))
    return loop, prepare(loop, driven), values


def bare_call(loop: ClosedLoop, experiment: Experiment, values: dict[str, float]) -> Callable[[], object]:
    """The kernel alone, with the arguments that `simulate_torque` gives it."""
    caught: list[tuple[Any, ...]] = []
    original = kernels.run

    def spy(*arguments: Any) -> int:
        caught.append(tuple(a.copy() if isinstance(a, np.ndarray) else a for a in arguments))
        return original(*arguments)

    kernels.run = spy
    try:
        simulate_torque(loop, experiment, values)
    finally:
        kernels.run = original
    arguments = caught[0]
    z, x = arguments[3], arguments[13]
    z0, x0 = z.copy(), x.copy()

    def call() -> None:
        z[:], x[:] = z0, x0
        original(*arguments)

    return call


def c_call(stick: Any) -> tuple[Callable[[], object], np.ndarray]:
    """The C stick's simulation alone, its arrays prepared."""
    expected = stick.c_sim()  # builds it
    w, q0 = stick._w()
    p, u, counts = np.ascontiguousarray(stick.P0, float), np.empty(len(w)), np.zeros(2, np.int64)
    keep = (p, w, u, counts)
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in keep]
    settings, n, start = ctypes.byref(stick._ctl), ctypes.c_int(len(w)), ctypes.c_double(q0)
    sim = stick._lib.sim
    sim.restype = None

    def call(_keep: object = keep) -> None:
        sim(n, pointers[0], settings, pointers[1], start, pointers[2], None, pointers[3])

    return call, expected


def scipy_torque(problem: dict[str, Any], n: int, smooth: float = 1e-3, rtol: float = 1e-6) -> np.ndarray:
    """The first `n` torques by solve_ivp: each held period on its own, Coulomb friction as Fc tanh(v / smooth).

    LSODA, which turns to a stiff method where the smoothed friction asks for one. A `sign` in place of the `tanh`
    makes the step collapse at the first standstill.
    """
    m1, fv1, fc1, k, f12, m2, fv2, fc2 = (float(value) for value in problem["parameters"])
    gains, period = problem["controller"], problem["sample_time"]
    kp, kd, alpha, limit = (gains[name] for name in ("kp", "kd", "alpha", "umax"))
    w = kp * problem["reference"] + kd * problem["reference_velocity"] + problem["pulse"]
    tanh = np.tanh

    def rates(_t: float, x: np.ndarray, torque: float) -> tuple[float, float, float, float]:
        q1, v1, q2, v2 = x
        spring = k * (q2 - q1) + f12 * (v2 - v1)
        return (
            v1,
            (torque + spring - fv1 * v1 - fc1 * tanh(v1 / smooth)) / m1,
            v2,
            (-spring - fv2 * v2 - fc2 * tanh(v2 / smooth)) / m2,
        )

    start = float(problem["reference"][0])
    x = np.array([start, 0.0, start, 0.0])
    velocity, before = 0.0, start
    torque = np.empty(n)
    for i in range(n):
        velocity = alpha * velocity + (1 - alpha) * (x[0] - before) / period
        before = x[0]
        torque[i] = min(max(w[i] - kp * x[0] - kd * velocity, -limit), limit)
        x = solve_ivp(rates, (0.0, period), x, "LSODA", args=(torque[i],), rtol=rtol, atol=1e-9).y[:, -1]
    return torque


def interleaved(calls: dict[str, Callable[[], object]], rounds: int) -> dict[str, np.ndarray]:
    """Seconds of every call in every round, in an order drawn anew each round."""
    random = np.random.default_rng(0)
    times = {name: np.empty(rounds) for name in calls}
    for call in calls.values():
        call()
    for i in range(rounds):
        for name in random.permutation(list(calls)):
            begin = time.perf_counter()
            calls[name]()
            times[name][i] = time.perf_counter() - begin
    return times


def compile_seconds() -> tuple[float, float]:
    """Seconds of the first simulation of all in a new process, with an empty cache and with a filled one."""
    program = (
        "import sys, time; sys.path.insert(0, sys.argv[1]); import simulation as s; import numpy as np\n"
        "r = 0.01 * np.sin(np.arange(50) / 9)\n"
        "p = dict(parameters=[70, 92, 10, 8e5, 126, 35, 110, 10], reference=r, reference_velocity=0 * r, pulse=0 * r,\n"
        "         controller=dict(kp=1e6, kd=1e4, alpha=.3, umax=1e3), sample_time=1e-3)\n"
        "a = s.our_loop(p); t = time.perf_counter(); s.simulate_torque(*a); print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as cache:
        command = [sys.executable, "-c", program, str(HERE)]
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    first, second = (float(run.stdout) for run in runs)
    return first, second


def measure(rounds: int) -> list[str]:
    """Run everything; return the table and what goes with it, as lines of Markdown."""
    folder = bench_dir()
    if folder is None:
        sys.exit("There is no measuring stick beside the records; set JOINTID_DATA to the folder of the records.")
    sys.path.insert(0, str(folder))
    import stick

    problem = stick.problem()
    loop, experiment, values = our_loop(problem)
    response = simulate_torque(loop, experiment, values)
    peak = np.max(np.abs(response.torque))
    random = np.random.default_rng(1)
    names = [name for name, value in values.items() if value != 0.0]
    candidates = [values | {name: values[name] * random.uniform(0.9, 1.1) for name in names} for _ in range(BATCH)]
    kernel, public = "kernel alone (`kernels.run`)", "one candidate (`simulate_torque`)"
    batches = {
        f"each of {BATCH} candidates, {workers} thread{'s' * (workers > 1)} (`simulate_many`)": workers
        for workers in (1, min(2, os.cpu_count() or 1))
    }
    calls: dict[str, Callable[[], object]] = {
        kernel: bare_call(loop, experiment, values),
        public: lambda: simulate_torque(loop, experiment, values),
        "one candidate with 8 derivatives (`simulate_sensitivities`)": lambda: simulate_sensitivities(
            loop, experiment, values, names
        ),
    }
    notes = []
    c = "plain C, gcc -O3 (the stick)"
    if shutil.which("gcc"):
        calls[c], expected = c_call(stick)
        error = np.max(np.abs(response.torque - expected)) / peak
        notes.append(f"- Worst difference of the torque from the C version: {error:.1e} of its peak.")
    else:
        notes.append("- The C version was left out: there is no gcc.")
    times = interleaved(calls, rounds)
    many = interleaved(
        {
            name: lambda workers=workers: simulate_many(loop, experiment, candidates, workers=workers)
            for name, workers in batches.items()
        },
        max(rounds // 40, 5),
    )
    times |= {name: values / BATCH for name, values in many.items()}

    begin = time.perf_counter()
    smoothed = scipy_torque(problem, STRETCH)
    samples = experiment.samples
    name = f"SciPy solve_ivp ({STRETCH} samples, scaled to {samples})"
    times[name] = np.array([(time.perf_counter() - begin) * samples / STRETCH])
    error = np.max(np.abs(smoothed - response.torque[:STRETCH])) / peak
    notes.append(
        f"- solve_ivp: LSODA at rtol 1e-6, one call per held period, Coulomb friction smoothed to Fc tanh(v / 1 mm/s); "
        f"its torque is off by up to {100 * error:.1f} % of the peak, and its axis creeps where it should stand."
    )
    first, second = compile_seconds()
    notes.append(f"- The first simulation of all takes {first:.1f} s to compile; in later processes {second:.2f} s.")

    base = times.get(c)
    header = "| | ms, median | quartiles | against C | against the kernel |"
    lines = [header, "|---|---|---|---|---|"]
    for label, seconds in times.items():
        low, middle, high = (1e3 * np.percentile(seconds, q) for q in (25, 50, 75))
        spread = f"{low:.3f} to {high:.3f}" if seconds.size > 1 else "once"
        against = [ratio(seconds, other) if other is not None else "-" for other in (base, times[kernel])]
        lines.append(f"| {label} | {middle:.3f} | {spread} | {against[0]} | {against[1]} |")
    libraries = ", ".join(f"{module.__name__} {module.__version__}" for module in (np, scipy, numba))
    versions = f"Python {platform.python_version()}, {libraries}"
    events = f"{samples} samples, {response.events} events"
    return [*lines, "", f"{events}; {rounds} rounds. {machine()}; {versions}.", "", *notes]


def ratio(seconds: np.ndarray, base: np.ndarray) -> str:
    """Median of the ratios of the same round, or of the medians where the rounds were not shared."""
    same = seconds.size == base.size
    return f"{np.median(seconds / base) if same else np.median(seconds) / np.median(base):,.2f}"


def machine() -> str:
    """The processor and the number of its cores."""
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.*)", info.read_text()) if info.is_file() else None
    return f"{found.group(1) if found else platform.processor() or platform.machine()}, {os.cpu_count()} cores"


def main() -> None:
    """Measure, print, and with --write put the table in README.md."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=400, help="of the interleaved single simulations")
    parser.add_argument("--write", action="store_true", help="rewrite the table in benchmarks/README.md")
    options = parser.parse_args()
    table = "\n".join(measure(options.rounds))
    print(table)
    if options.write:
        page = HERE / "README.md"
        head, rest = page.read_text().split(MARKS[0])
        page.write_text(f"{head}{MARKS[0]}\n\n{table}\n\n{MARKS[1]}{rest.split(MARKS[1])[1]}")


if __name__ == "__main__":
    main()
