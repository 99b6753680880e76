"""How a page is run: its blocks one after the other in one folder, as a reader would."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
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
_USERS_MISTAKE = "jointid: "
"""What the first printed line of a refusal begins with."""


def run_page(page: Path, folder: Path, real_records: Callable[[], Path]) -> str:
    """Run a page in a folder and return all that it printed.

    Args:
        page: whose blocks are run; what it shows of their output is compared with it.
        folder: an empty one.
        real_records: gives the folder of the real records, or skips the test.
    """
    prepare(page, folder, real_records)
    names: dict[str, Any] = {"__name__": "__main__"}
    found = blocks(page)
    everything, said, section = "", "", 0
    with _inside(folder):
        for block, after in zip_longest(found, found[1:]):
            if block.section != section:  # what another section printed is not what this one shows
                said, section = "", block.section
            if block.file is not None:
                Path(block.file).write_text(block.text, encoding="utf-8")
            elif block.runs:
                refused = after is not None and not after.language and after.text.startswith(_USERS_MISTAKE)
                printed = _run(block, names, refused=refused)
                said, everything = said + printed, everything + printed
            elif not block.language and said:
                for line in block.text.splitlines():
                    assert shown(line, said), f"{page.name}:{block.line}: {line!r} was not printed:\n{said}"
    return everything


def prepare(page: Path, folder: Path, real_records: Callable[[], Path]) -> None:
    """Put into a folder what a page takes for granted: the examples, the real records it names, and its own files."""
    for name in ("examples", "benchmarks"):
        (folder / name).symlink_to(ROOT / name)
    text = page.read_text(encoding="utf-8")
    if wanted := set(re.findall(r"(?:DATA_\w+|MultisineTypeA|rec_[AB])\.mat", text)):
        for path in real_records().rglob("*.mat"):
            if path.name in wanted:
                (folder / path.name).symlink_to(path)
    name = page.relative_to(ROOT).as_posix()
    if name in TAKEN_FOR_GRANTED:
        TAKEN_FOR_GRANTED[name](folder)


def shown(line: str, said: str) -> bool:
    """Return whether a line that a page shows was printed: its words as they are, its numbers but for their last digit.

    The page may leave out what follows in the line, and all lines around it.
    """
    words = _words(line)
    return any(
        len(printed) >= len(words) and all(map(_same, words, printed)) for printed in map(_words, said.splitlines())
    )


def _words(line: str) -> list[str]:
    return line.replace(",", " ").split()


def _same(shown_word: str, printed: str) -> bool:
    try:
        return float(shown_word) == pytest.approx(float(printed), rel=0.05)  # another machine rounds elsewhere
    except ValueError:
        return shown_word == printed


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
        code, expected = end.value.code, 2 if refused and _USERS_MISTAKE in errors.getvalue() else 0
        assert code == expected, f"{command}: exit code {code}\n{errors.getvalue()}"
        return errors.getvalue() if refused else ""
    if words[0] == "python":  # this one, whatever the path says
        command = shlex.join([sys.executable, *words[1:]])
    # Nothing of the project's own makes a command line: those of the pages are reviewed like any program.
    return subprocess.run(["bash", "-c", command], check=True, capture_output=True, text=True).stdout


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _of_the_readme(folder: Path) -> None:
    """Write the record of a geared axis under the law of the README's joint file, as its user has it."""
    text = next(block.text for block in blocks(ROOT / "README.md") if block.file)
    (folder / "joint.toml").write_text(text, encoding="utf-8")
    reference = ji.excitation.trapezoids([0.2, 0.4, 0.8], 4.0, 0.4, 1e-3, rest=0.1, duration=12.0)
    noise = 2.0 * np.random.default_rng(0).standard_normal(reference.size)
    _write_log(folder / "joint.toml", reference, README_AXIS, noise, folder / "run.csv")


README_AXIS = {
    "motor_inertia": 15.0, "motor_viscous": 60.0, "motor_coulomb": 40.0,
    "stiffness": 1e5, "damping": 30.0,
    "load_inertia": 12.0, "load_viscous": 40.0, "load_coulomb": 25.0, "offset": 5.0,
}  # fmt: skip
"""What the README's record is simulated with, on the load side."""


def _of_the_joint_file(folder: Path) -> None:
    """Write the shortest joint file of the page, and a record for it."""
    text = blocks(ROOT / "docs" / "joint-file.md")[0].text
    (folder / "joint.toml").write_text(text, encoding="utf-8")
    reference = ji.excitation.trapezoids([0.05, 0.1, 0.2], 2.0, 0.1, 1e-3, rest=0.1, duration=12.0)
    values = {"inertia": 60.0, "viscous": 120.0, "coulomb": 15.0, "offset": 0.0}
    noise = np.random.default_rng(0).standard_normal(reference.size)
    _write_log(folder / "joint.toml", reference, values, noise, folder / "run1.csv")


def _write_log(
    joint: Path, reference: FloatArray, values: Mapping[str, float], noise: FloatArray, target: Path
) -> None:
    file = ji.load(joint)
    assert file.loop is not None
    record = ji.simulated_record(file.loop, reference, values, sample_time=1e-3, torque_noise=noise)
    file.write(record, target)


def _of_the_drives(folder: Path) -> None:
    """Write a trace with the objects of CiA 402."""
    time = 2.5e-4 * np.arange(400)
    columns = [time, np.round(50 * np.sin(20 * time)), np.round(4e4 * time), np.round(4e4 * time)]
    header = "t,6077h,6062h,6064h"
    np.savetxt(folder / "trace.csv", np.column_stack(columns), delimiter=",", header=header, comments="")


TAKEN_FOR_GRANTED: dict[str, Callable[[Path], None]] = {
    "README.md": _of_the_readme,
    "docs/joint-file.md": _of_the_joint_file,
    "docs/drives.md": _of_the_drives,
}
"""By the page, what makes the files that its commands speak of and the reader has."""
