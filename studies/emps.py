"""Residuals of the EMPS records in the terms of the literature: band, step and hold beside every per cent.

`python -m studies.emps FOLDER` prints the table of `docs/how-well-it-works.md` from the folder with both records. With
`--outputs` it prints that of force and position alone, whose last column is the benchmark's own measure.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

import jointid as ji
from jointid.models.friction import AsymmetricFriction, AsymmetricStribeckFriction, SymmetricFriction
from jointid.simulation.closed_loop import Initial, simulate
from jointid.simulation.loop_input import prepare

RECORDS = ("DATA_EMPS", "DATA_EMPS_PULSES")
JOINT = Path(__file__).parent.parent / "examples" / "emps" / "joint.toml"
BAND = ji.Filtering(position_cutoff=100.0, cutoff=100.0, borders=(49, 0))
"""100 Hz, every fourth sample, as comparisons of the record's models have it."""

METHODS: dict[str, tuple[ji.DIDIM | ji.IDIM, ji.Filtering]] = {
    "measured motion, 100 Hz, every 4th sample, force as sampled": (ji.IDIM(), replace(BAND, timing="as_sampled")),
    "measured motion, 100 Hz, every 4th sample, force held 1 ms": (ji.IDIM(), BAND),
    "measured motion, 40 Hz, every 10th sample, force held 1 ms (default)": (ji.IDIM(), ji.Filtering()),
    "simulated motion, 100 Hz, every 4th sample": (ji.DIDIM(), BAND),
    "simulated motion, 40 Hz, every 10th sample (default)": (ji.DIDIM(), ji.Filtering()),
    "simulated motion, 40 Hz, delay of the force identified": (ji.DIDIM(free=("delay",)), ji.Filtering()),
}
RAW = "the same, raw force, every sample"
FRICTIONS = (SymmetricFriction(), AsymmetricFriction(), AsymmetricStribeckFriction())
_LEFT_OUT = 20  # samples, of the benchmark's measure


def residuals(folder: Path) -> Iterator[tuple[str, str, tuple[float | None, ...]]]:
    """Yield method, record, and the residuals of all frictions, in % of the force; None where a method has no such."""
    file = ji.load(JOINT)
    assert file.loop is not None
    for name, (method, filtering) in METHODS.items():
        for record in RECORDS:
            filtered: list[float | None] = []
            raw: list[float | None] = []
            for friction in FRICTIONS:
                if isinstance(method, ji.IDIM) and not friction.linear:
                    filtered.append(None)
                    continue
                loop = replace(file.loop, joint=replace(file.loop.joint, friction=friction))
                logged = file.record(folder / f"{record}.mat")
                found = ji.identify(logged, loop, method, filtering=filtering, checks=False)
                filtered.append(100 * found.fit.filtered_error)
                raw.append(100 * found.fit.relative_error)
            yield name, record, tuple(filtered)
            if isinstance(method, ji.DIDIM) and method.free:
                yield RAW, record, tuple(raw)


def outputs(folder: Path) -> Iterator[tuple[str, str, list[tuple[float, float]], tuple[float, float, float]]]:
    """Yield record, output, parameters with 2 sigma, and the errors of the raw force (%) and of both positions (mm).

    The first position is that of the simulated loop. The second is the benchmark's measure: the motor in open loop
    under the force that PULSES logged, from rest, without its first samples.
    """
    file = ji.load(JOINT)
    assert file.loop is not None
    records = {name: file.record(folder / f"{name}.mat") for name in RECORDS}
    driven = records["DATA_EMPS_PULSES"]
    assert driven.torque is not None and driven.motor_position is not None
    position = driven.motor_position.values
    start = Initial(float(position[0]), 0.0)
    force = ji.Channel(driven.torque.values, "m", driven.torque.sample_time)  # a law without feedback hands it on
    passing = ji.controller.StateSpaceController(A=np.zeros((0, 0)), B={}, C=np.zeros(0), D={"reference": 1.0})
    loop_of_force = ji.ClosedLoop(file.loop.joint, passing)
    for name, record in records.items():
        for output in ("torque", "motor_position"):
            found = ji.identify(record, file.loop, ji.DIDIM(outputs=(output,)), checks=False)
            rows = [row for row in found.params.rows if row.of_joint and row.free]
            values = {row.name: row.value or 0.0 for row in rows}
            loop = ji.validate(found, record).axes[0]
            assert record.motor_position is not None
            simulated = loop.motor.position
            follows = math.sqrt(float(np.mean((record.motor_position.values[: simulated.size] - simulated) ** 2)))
            run = simulate(loop_of_force, prepare(loop_of_force, ji.Record(reference=force)), values, start)
            off = math.sqrt(float(np.mean((run.motor_position - position)[_LEFT_OUT:] ** 2)))
            errors = (100 * loop.relative_error, 1e3 * follows, 1e3 * off)
            yield name, output, [(row.value or 0.0, 2 * (row.deviation or 0.0)) for row in rows], errors


def main() -> None:
    """Print the table."""
    if "--outputs" in sys.argv:
        for record, output, values, errors in outputs(Path(sys.argv[1])):
            cells = [record.removeprefix("DATA_"), {"torque": "force"}.get(output, "position")]
            cells += [f"{value:.2f} ± {band:.2f}" for value, band in values]
            cells += [f"{errors[0]:.2f}", f"{errors[1]:.4f}", f"{errors[2]:.2f}"]
            sys.stdout.write(f"| {' | '.join(cells)} |\n")
        return
    for name, record, left in residuals(Path(sys.argv[1])):
        cells = [name, record.removeprefix("DATA_"), *("" if one is None else f"{one:.2f}" for one in left)]
        sys.stdout.write(f"| {' | '.join(cells)} |\n")


if __name__ == "__main__":
    main()
