"""Sound files of every kind that the package reads, from which mutations are made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

from jointid.output.json.documents import REPORT_ELEMENT, REPORT_SCHEMA
from jointid.output.json.estimates import ESTIMATE_SCHEMA
from tests.records.logged import LOGGED

ROWS = "".join(f"{k * 0.001:.3f},{k % 7},{k * 0.01:.2f}\n" for k in range(120))
TEXTS = {
    "comma.csv": f"t,i,r\n{ROWS}".encode(),
    "comment.csv": f"# made by a drive\n# t [ms],i [A],r [mm]\n{ROWS}".encode(),
    "decimal comma.csv": ("t;i;r\n" + ROWS.replace(",", ";").replace(".", ",")).encode("latin-1"),
    "quoted.csv": b'"t","i, of the motor","r ""set"""\n'
    + ("".join(f'"{k}","{k % 7}","{k * 0.5}"\n' for k in range(120))).encode(),
    "blanks.txt": ROWS.replace(",", "  ").encode("utf-16"),
    "scope.csv": b"Name\trun\nStarttime of export\t132959733843760000\n\nName\tA\tName\tB\nSampleTime[ms]\t1\t"
    b"SampleTime[ms]\t1\nUnit\t(None)\tUnit\tmm (Length)\n\n"
    + b"".join(b"%d\t%d,5\t%d\t%d\n" % (k, k, k, k) for k in range(50))
    + b"EOF\n",
}
JOINT = """[joint]
kind = "prismatic"
friction = "asymmetric"
[record]
file = "run.csv"
time = "t"
[record.channels]
torque = { column = "i", unit = "N" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = 100.0
velocity_gain = 2000.0
velocity_filter = { kind = "notch", frequency = 80.0, bandwidth = 20.0 }
[filtering]
cutoff = 40.0
[method]
name = "didim"
[parameters]
offset = 0.0
"""
_VALUES = {"inertia": ("kg", 1.0), "viscous": ("N s/m", 1.0), "coulomb": ("N", 1.0), "offset": ("N", 1.0)}
ANSWER = {
    "schema": ESTIMATE_SCHEMA, "model": "rigid", "kind": "prismatic", "friction": "symmetric", "gravity": None,
    "transmission": None, "method": "didim", "variant": "DIDIM", "delay": 0.0, "controller_sha256": "", "effects": [],
    "record": {"name": "run", "torque_sha256": "x", "torque_unit": "N"}, "relative_error_percent": 3.0,
    "combinations": [],
    "parameters": {
        name: {"value": value, "unit": unit, "symbol": name[0], "std": 0.1, "free": True}
        for name, (unit, value) in _VALUES.items()
    },
    "filtering": {
        "position_cutoff": 1.0, "cutoff": 1.0, "decimation": 1, "borders": [0, 0], "timing": "respected",
        "aliasing": "refused",
    },
}  # fmt: skip


class Sample(NamedTuple):
    """A sound file: what reads it, "record", "joint" or "answer", how it is called, and what is in it."""

    reader: str
    name: str
    content: bytes


def make_samples(folder: Path) -> list[Sample]:
    """Return all of them; files of the binary formats are written by their own libraries."""
    samples = [Sample("record", name, content) for name, content in TEXTS.items()]
    for kind, logged in LOGGED.items():
        path = folder / f"{kind}{logged.suffix}"
        logged.write(path)
        samples.append(Sample("record", path.name, path.read_bytes()))
    answer, report = json.dumps(ANSWER), json.dumps({"schema": REPORT_SCHEMA, "estimate": ANSWER})
    page = f'<!doctype html><title>run</title><script id="{REPORT_ELEMENT}" type="application/json">{report}</script>'
    samples += [
        Sample("joint", "joint.toml", JOINT.encode()),
        Sample("answer", "answer.json", answer.encode()),
        Sample("answer", "report.json", report.encode()),
        Sample("answer", "report.html", page.encode()),
    ]
    return samples
