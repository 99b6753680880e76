"""A process that works for the page: `python -m jointid.apps.web.worker MEMORY WORDS`.

The words are those of a command of jointid, or one of the actions below, in the current folder. A file may be damaged
and a fit may take hours: whatever becomes of the process, the page stays up, and its memory is bounded. It ends when
the page does, whose end it hears on its standard input. A refusal is printed as that of a command.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from jointid.apps.web.folder import Draft
from jointid.apps.web.form import TEXT, at
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.records.inspection import find_band

_DRAWN, _LISTED = 64, 2000  # columns that are drawn, and whose names are listed
_LIBRARIES = 2**29  # bytes of addresses that the libraries of the formats take, most of which are never touched
_WIDTH, _HEIGHT, _LEFT, _RIGHT, _TOP, _BOTTOM = 640, 150, 74, 8, 10, 24
_LINE = "#0072B2"  # that of what is measured, in all our figures


def preview(draft: Draft) -> None:
    """Write the names of the first record's columns, their plots, and what the names say of the drive."""
    from jointid.records.formats import read_table
    from jointid.records.recognition import recognise

    options = {one.key.partition(".")[2]: at(draft.tables, one.key) for one in TEXT}
    given = {key: value for key, value in options.items() if value is not None}
    every = [read_table(draft.path / name, **given).columns for name in draft.records]
    columns = every[0]
    if not columns:
        raise JointidError(f"{draft.records[0]} holds no column with more than one number; choose another file.")
    names, log = list(columns), recognise(tuple(columns))
    for k, name in enumerate(names[:_DRAWN]):
        (draft.path / f"_plot-{k}.svg").write_text(draw_column(columns[name]), encoding="utf-8")
    drive, sentence = dict[str, Any](), ""
    if log is not None:
        place = log.axes[0].place if len(log.axes) > 1 else {}
        drive = {"profile": log.profile.name} | {key: value for key, value in place.items() if key != "index"}
        sentence = log.sentence
    listed = [
        {"name": name, "samples": columns[name].size, "plot": f"{k}.svg" if k < _DRAWN else ""}
        for k, name in enumerate(names[:_LISTED])
    ]
    draft.write_json("_columns.json", {"columns": listed, "count": len(names), "drive": drive, "sentence": sentence})


def example(draft: Draft) -> None:
    """Simulate the digital twin, and write its record and joint file."""
    from jointid import twin, write
    from jointid.paper.twin import JOINT_FILE

    write(twin().record, draft.path / "example.csv")
    draft.write(JOINT_FILE.replace(", optional = true", ""))  # this record has every channel


def check(draft: Draft) -> None:
    """Read the records as the forms say, and write what the first one holds."""
    from jointid.config import load_joint

    file = load_joint(draft.path / "_reading.toml")
    first, *_ = [file.record(draft.path / name) for name in draft.records[: 1 if file.source.files else None]]
    torque = first.torque
    assert torque is not None
    size = {"samples": len(torque), "sample_time": torque.sample_time, "duration": torque.duration, "unit": torque.unit}
    draft.write_json("_checked.json", size)


def draw_column(values: FloatArray) -> str:
    """Return a column as SVG, which a browser shows without running anything: a line through lows and highs."""
    finite, base = values[np.isfinite(values)], _HEIGHT - _BOTTOM
    body = '<text x="320" y="80" text-anchor="middle">no numbers</text>'
    if finite.size:
        low, high = float(finite.min()), float(finite.max())
        bottom, span = (low, high - low) if high > low else (low - 0.5, 1.0)
        sides = np.stack(find_band(np.where(np.isfinite(values), values, np.nan), _WIDTH), axis=1)
        ends = np.repeat(np.arange(len(sides)), 2), sides.ravel()
        across, up = (_LEFT + (_WIDTH - _LEFT - _RIGHT) * ends[0] / max(ends[0][-1], 1), (ends[1] - bottom) / span)
        points = [(x, base - (base - _TOP) * y) for x, y in zip(across, up, strict=True) if np.isfinite(y)]
        body = f'<polyline fill="none" stroke="{_LINE}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'
        for value, y in ((high, _TOP + 8), (low, base)) if high > low else ((low, (_TOP + base) / 2),):
            body += f'<text x="{_LEFT - 6}" y="{y:g}" text-anchor="end">{number(value, 4)}</text>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        f'font-size="13" fill="#4a545e"><path d="M{_LEFT} {_TOP}V{base}H{_WIDTH - _RIGHT}" fill="none" '
        f'stroke="#8a949e"/><text x="{_LEFT}" y="{_HEIGHT - 6}">0</text><text x="{_WIDTH - _RIGHT}" '
        f'y="{_HEIGHT - 6}" text-anchor="end">{values.size} rows</text>{body}</svg>'
    )


def _end_with_the_page() -> None:
    """Wait for the end of standard input, which comes when the page ends, however it does."""
    while os.read(0, 1):  # past the buffer, whose lock a thread must not hold when Python ends
        pass
    os._exit(1)


def _limit_memory(most: int) -> None:
    """Bound the memory beside that of the libraries, in bytes, on Linux."""
    if sys.platform != "linux":
        return
    import resource

    taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    least = taken + _LIBRARIES + most
    resource.setrlimit(resource.RLIMIT_AS, (least if hard == resource.RLIM_INFINITY else min(least, hard), hard))


def _act(words: list[str]) -> None:
    """Carry out an action, or a command, and exit as the command does."""
    action = {"preview": preview, "example": example, "check": check}.get(words[0])
    if action is None:
        from jointid.apps.cli import main

        main(words)
    else:
        try:
            action(Draft(Path.cwd()))
        except JointidError as error:
            sys.stderr.writelines(f"jointid: {line}\n" for line in str(error).splitlines())
            sys.exit(2)


if __name__ == "__main__":
    threading.Thread(target=_end_with_the_page, daemon=True).start()
    # Beside the libraries: one that is loaded at the limit fails in ways of its own, not with `MemoryError`.
    _limit_memory(int(sys.argv[1]))
    _act(sys.argv[2:])
