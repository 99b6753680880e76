"""How long, and in how much memory, a joint is identified from hours of its log.

    python benchmarks/long_records.py [--hours 1 4 24] [--csv] [--drifting]

Writes records of the paper's flexible axis under its loop L19 to a temporary folder, some minutes after the other, and
identifies each in a process of its own. The axis runs trapezoids all day, with pulses on its torque and a white force
in the loop that leaves about 8 % of the torque. With `--drifting` its viscous friction falls by a fifth as it warms up.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import jointid as ji
from jointid.paper.twin import CONTROLLERS, TABLE_2
from jointid.simulation.closed_loop import Initial

PERIOD = 1e-3  # s
LAP, PART = 20.0, 600.0  # s, of a lap, and of what is simulated at once
FORCE = 10.0  # N, of the white force in the loop
WARM = 2.0  # h, in which the axis warms up to all but a third
ROW = np.dtype([("torque", "<f4"), ("reference", "<f8"), ("injected", "<f4")])
LOOP = ji.ClosedLoop(ji.FlexibleJoint("prismatic"), CONTROLLERS["L19"])
CHILD = "--identify"


def laps() -> np.ndarray:
    """Return a reference that ends where it begins, at rest: there and back at three speeds, every 20 s."""
    lap = ji.excitation.trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, PERIOD)
    return np.tile(np.concatenate([lap, np.zeros(round(LAP / PERIOD) - lap.size)]), round(PART / LAP))


def part(number: int, begin: Initial, drifting: bool) -> tuple[np.ndarray, Initial]:
    """Return some minutes of the axis, and where its motor stands after them."""
    cooled = 0.2 * (1 - np.exp(-number * PART / 3600 / WARM)) if drifting else 0.0
    truth = {n: v * (1 - cooled) if n.endswith("viscous") else v for n, v in TABLE_2.items()}
    reference = laps()
    injected = ji.excitation.pulses(reference.size, PERIOD, height=150.0, width=0.02, every=0.4, seed=number)
    force = FORCE * np.random.default_rng(number).standard_normal(reference.size)
    record = ji.simulated_record(
        LOOP, reference, truth, sample_time=PERIOD, injected=injected, disturbance=force, initial=begin
    )
    assert record.torque is not None
    assert record.motor_position is not None
    rows = np.empty(reference.size, dtype=ROW)
    rows["torque"], rows["reference"], rows["injected"] = record.torque.values, reference, injected
    return rows, Initial(float(record.motor_position.values[-1]), 0.0)


def written(path: Path, hours: float, drifting: bool) -> None:
    """Write a record of so many hours, a part after the other."""
    parts, state = round(hours * 3600 / PART), Initial()
    samples = parts * round(PART / PERIOD)
    with path.open("wb") as file:
        if path.suffix == ".npy":
            header = {"descr": np.lib.format.dtype_to_descr(ROW), "fortran_order": False, "shape": (samples,)}
            np.lib.format.write_array_header_1_0(file, header)
        else:
            file.write(f"{','.join(ROW.names or ())}\n".encode())
        for number in range(parts):
            rows, state = part(number, state, drifting)
            if path.suffix == ".npy":
                rows.tofile(file)
            else:
                np.savetxt(file, np.column_stack([rows[name] for name in ROW.names or ()]), fmt="%.7g", delimiter=",")


def identify(path: Path, window: float) -> None:
    """Identify one record in this process, and print what it took and what it found."""
    channels = {"torque": "torque", "reference": "reference", "injected": "injected"}
    log = ji.Log(path, channels, {"sample_time": PERIOD, "kind": "prismatic"})
    small = next(log.chunks(20_000, 0)).record
    method = ji.DIDIM(frequency=30.0)
    ji.identify(small, LOOP, method, windows=ji.Windowing(length=8.0))  # compiles, or loads what is
    before = peak()
    begun = time.perf_counter()
    found = ji.identify(log, LOOP, method, windows=ji.Windowing(length=window))
    took = time.perf_counter() - begun
    hours = found.data.windows.duration / 3600
    print(
        f"| {path.suffix[1:]} | {hours:.2f} | {path.stat().st_size / 1e6:.0f} | {found.fit.passes} | "
        f"{found.fit.simulations} | "
        f"{took:.1f} | {took / hours:.1f} | {before:.0f} | {peak():.0f} |"
    )
    print(f"\n{found}\n", file=sys.stderr)


def peak() -> float:
    """Return the most memory this process has had, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Write, identify, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, nargs="+", default=[1.0, 4.0, 24.0])
    parser.add_argument("--window", type=float, default=60.0)
    parser.add_argument("--csv", action="store_true", help="the shortest also as text")
    parser.add_argument("--drifting", action="store_true")
    parser.add_argument(CHILD, type=Path, dest="child")
    asked = parser.parse_args()
    if asked.child is not None:
        identify(asked.child, asked.window)
        return
    print("| | h | MB | passes | windows simulated | s | s per h | MB of memory before | at most |")
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    cases = [(hours, ".npy") for hours in asked.hours] + ([(min(asked.hours), ".csv")] if asked.csv else [])
    with tempfile.TemporaryDirectory() as folder:
        for hours, suffix in cases:
            path = Path(folder) / f"record{suffix}"
            written(path, hours, asked.drifting)
            subprocess.run([sys.executable, __file__, CHILD, str(path), "--window", str(asked.window)], check=True)
            path.unlink()


if __name__ == "__main__":
    main()
