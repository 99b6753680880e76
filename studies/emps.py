"""Residuals of the EMPS records in the terms of the literature: band, step and hold beside every per cent.

`python -m studies.emps FOLDER` prints the table of `docs/how-well-it-works.md` from the folder with both records.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import jointid as ji
from jointid.models.friction import Friction

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
FRICTIONS = (Friction(), Friction("asymmetric"), Friction("asymmetric-stribeck"))


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


def main() -> None:
    """Print the table."""
    for name, record, left in residuals(Path(sys.argv[1])):
        cells = [name, record.removeprefix("DATA_"), *("" if one is None else f"{one:.2f}" for one in left)]
        sys.stdout.write(f"| {' | '.join(cells)} |\n")


if __name__ == "__main__":
    main()
