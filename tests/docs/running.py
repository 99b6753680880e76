"""How a page is run: its blocks one after the other in one folder, as a reader would."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli import main
from jointid.common.arrays import FloatArray
from tests.docs.blocks import ROOT, Block, blocks

_UV = re.compile(r"^(?:python3 -m pip install uv && )?(?:python3 -m uv run )?")
_REFUSAL = "jointid: "


def run_page(page: Path, folder: Path, real_records: Callable[[], Path]) -> str:
    """Run a page in a folder and return all that it printed.

    Args:
        page: whose blocks are run; what it shows of their output is compared with it.
        folder: an empty one.
        real_records: gives the folder of the real records, or skips the test.
    """
    _prepare(page, folder, real_records)
    names: dict[str, Any] = {"__name__": "__main__"}
    found = blocks(page)
    everything, said, section = "", "", 0
    with contextlib.chdir(folder):
        for block, after in zip_longest(found, found[1:]):
            if block.section != section:  # what another section printed is not what this one shows
                said, section = "", block.section
            if block.file is not None:
                Path(block.file).write_text(block.text, encoding="utf-8")
            elif block.runs:
                refused = after is not None and not after.language and after.text.startswith(_REFUSAL)
                printed = _run(block, names, refused=refused)
                said, everything = said + printed, everything + printed
            elif not block.language and said:
                for line in block.text.splitlines():
                    assert _is_shown(line, said), f"{page.name}:{block.line}: {line!r} was not printed:\n{said}"
    return everything


def _prepare(page: Path, folder: Path, real_records: Callable[[], Path]) -> None:
    """Put into a folder what a page takes for granted: the examples, the real records it names, and its own files."""
    (folder / "examples").symlink_to(ROOT / "examples")
    text = page.read_text(encoding="utf-8")
    if wanted := set(re.findall(r"(?:DATA_\w+|MultisineTypeA|rec_[AB])\.mat", text)):
        for path in real_records().rglob("*.mat"):
            if path.name in wanted:
                (folder / path.name).symlink_to(path)
    if page == ROOT / "README.md":  # the record of a geared axis under the law of its joint file
        reference = ji.excitation.trapezoids([0.2, 0.4, 0.8], 4.0, 0.4, 1e-3, rest=0.1, duration=12.0)
        text = next(block.text for block in blocks(page) if block.file)
        _write_log(folder / "run.csv", text, reference, README_AXIS, noise=2.0)
    elif page.name == "joint-file.md":  # a record for its shortest joint file
        reference = ji.excitation.trapezoids([0.05, 0.1, 0.2], 2.0, 0.1, 1e-3, rest=0.1, duration=12.0)
        values = {"inertia": 60.0, "viscous": 120.0, "coulomb": 15.0, "offset": 0.0}
        _write_log(folder / "run1.csv", blocks(page)[0].text, reference, values, noise=1.0)
    elif page.name == "drives.md":  # a trace with the objects of CiA 402
        time = 2.5e-4 * np.arange(400)
        columns = [time, np.round(50 * np.sin(20 * time)), np.round(4e4 * time), np.round(4e4 * time)]
        header = "t,6077h,6062h,6064h"
        np.savetxt(folder / "trace.csv", np.column_stack(columns), delimiter=",", header=header, comments="")


README_AXIS = {
    "motor_inertia": 15.0, "motor_viscous": 60.0, "motor_coulomb": 40.0, "stiffness": 1e5, "damping": 30.0,
    "load_inertia": 12.0, "load_viscous": 40.0, "load_coulomb": 25.0, "offset": 5.0,
}  # fmt: skip
"""What the README's record is simulated with, on the load side."""


def _write_log(target: Path, text: str, reference: FloatArray, values: Mapping[str, float], noise: float) -> None:
    """Write a joint file and a record for it beside each other."""
    joint = target.with_name("joint.toml")
    joint.write_text(text, encoding="utf-8")
    file = ji.load(joint)
    white = noise * np.random.default_rng(0).standard_normal(reference.size)
    record = ji.simulated_record(file.loop, reference, values, sample_time=1e-3, torque_noise=white)
    file.write(record, target)


def _is_shown(line: str, said: str) -> bool:
    """Return whether a line that a page shows was printed: its words as they are, its numbers but for their last digit.

    The page may leave out what follows in the line, and all lines around it.
    """
    words = _words(line)
    return any(
        len(printed) >= len(words) and all(map(_is_same, words, printed)) for printed in map(_words, said.splitlines())
    )


def _words(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _is_same(shown: str, printed: str) -> bool:
    try:
        return float(shown) == pytest.approx(float(printed), rel=0.05)  # another machine rounds elsewhere
    except ValueError:
        return shown == printed


def _run(block: Block, names: dict[str, Any], *, refused: bool) -> str:
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        if block.language == "sh":
            for command in block.commands():
                out.write(_command(_UV.sub("", command), refused=refused))
        else:
            exec(compile(block.text, f"line {block.line}", "exec"), names)
    return out.getvalue()


def _command(command: str, *, refused: bool) -> str:
    """Run a command line; what it prints to the standard output is already on its way."""
    words = shlex.split(command)
    if words[0] == "jointid":
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors), pytest.raises(SystemExit) as end:
            main([*words[1:]])
        assert end.value.code == (2 if refused else 0), f"{command}: {end.value.code}\n{errors.getvalue()}"
        return errors.getvalue() if refused else ""
    if words[0] == "python":  # this one, whatever the path says
        command = shlex.join([sys.executable, *words[1:]])
    # Nothing of the project's own makes a command line: those of the pages are reviewed like any program.
    return subprocess.run(["bash", "-c", command], check=True, capture_output=True, text=True).stdout
