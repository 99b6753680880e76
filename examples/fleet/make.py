"""A fleet to try campaigns on: records of many joints over many days, simulated, with faults that are known.

    python examples/fleet/make.py fleet --joints 20 --days 20

Every joint is the twin's axis with parameters of its own, which scatter from day to day. Some records are spoiled, and
the stiffness of the first joints falls from some day on.
"""

from __future__ import annotations

import argparse
import datetime
import shutil
from pathlib import Path

import numpy as np

import jointid as ji
from jointid.paper.twin import CONTROLLERS, TABLE_2

HERE = Path(__file__).resolve().parent
FIRST_DAY = datetime.date(2026, 10, 1)
SCATTER = {"stiffness": 0.005, "motor_coulomb": 0.03, "load_coulomb": 0.03, "motor_viscous": 0.03, "load_viscous": 0.03}
"""Standard deviation from day to day, as a share of the value."""

TABLE = "name,filtering.cutoff,method.frequency"
"""Columns of the table of joints: each may be given its own values."""


def make(folder: Path, joints: int, days: int, spoiled: float, falling: int, fall: float, seed: int = 1) -> None:
    """Write the fleet, with its table, the campaign files and the joint file beside it.

    Args:
        folder: is made.
        joints: how many.
        days: one record of each joint a day.
        spoiled: share of the records.
        falling: joints whose stiffness falls, the first ones.
        fall: by what share, from a day between a third and two thirds on.
        seed: of all that is drawn.
    """
    loop = ji.ClosedLoop(ji.FlexibleJoint("prismatic"), CONTROLLERS["L19"])
    reference = ji.excitation.trapezoids((0.042, 0.083, 0.125), 0.83, 0.1, 1e-3, duration=8.0)
    pulses = ji.excitation.pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=0)
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("campaign.toml", "campaign-table.toml", "joint.toml"):
        shutil.copyfile(HERE / name, folder / name)
    names = [f"axis-{number + 1:03}" for number in range(joints)]
    (folder / "fleet.csv").write_text("".join(f"{line}\n" for line in (TABLE, *(f"{name},60,30" for name in names))))
    for number, name in enumerate(names):
        draw = np.random.default_rng([seed, number])
        own = {name: value * (1 + 0.1 * draw.uniform(-1, 1)) for name, value in TABLE_2.items()}
        begins = int(draw.integers(days // 3, max(2 * days // 3, days // 3 + 1)))
        place = folder / "logs" / name
        place.mkdir(parents=True, exist_ok=True)
        for day in range(days):
            today = {name: value * (1 + SCATTER.get(name, 0.0) * draw.standard_normal()) for name, value in own.items()}
            if number < falling and day >= begins:
                today["stiffness"] *= 1 - fall
            force = 10.0 * draw.standard_normal(reference.size)
            record = ji.simulated_record(
                loop, reference, today, sample_time=1e-3, injected=pulses, disturbance=force, encoder_step=5e-8
            )
            path = place / f"{FIRST_DAY + datetime.timedelta(days=day)}.npy"
            ji.write(record, path)
            if draw.random() < spoiled:
                spoil(path, int(draw.integers(3)))


def spoil(path: Path, way: int) -> None:
    """Spoil a record: the file is cut off, empty, or of another kind."""
    content = path.read_bytes()
    path.write_bytes((content[: len(content) // 3], b"", b"the drive could not be reached\n")[way])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--joints", type=int, default=20)
    parser.add_argument("--days", type=int, default=20)
    parser.add_argument("--spoiled", type=float, default=0.05)
    parser.add_argument("--falling", type=int, default=3)
    parser.add_argument("--fall", type=float, default=0.1)
    parser.add_argument("--seed", type=int, default=1)
    make(**vars(parser.parse_args()))
