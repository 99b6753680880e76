"""Files of others: whatever stands in a text format, a joint file or an answer, it is read or refused in a sentence.

Nothing in it is run, reaches the terminal as a command, or takes memory out of proportion.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import jointid as ji
from jointid.apps.cli.app import _run
from jointid.apps.cli.console import show
from jointid.common.errors import JointidError, RecordError
from jointid.common.text import printable, short
from jointid.config import load
from jointid.records.resampling import Resampling

pytestmark = pytest.mark.hostile

ROWS = "".join(f"{k * 0.001:.3f},{k % 7},{k * 0.01:.2f}\n" for k in range(300))
LOG = ("t,i,r\n" + ROWS).encode()
JOINT = """[joint]
kind = "prismatic"
[record]
file = "run.csv"
sample_time = 1e-3
[record.channels]
torque = { column = "i" }
reference = { column = "r" }
[controller]
law = "cascade"
position_gain = 100.0
velocity_gain = 2000.0
"""


def names_of(names: bytes) -> bytes:
    return b"t," + names + b",r\n0,1,2\n1,2,3\n"


def times(scale: str, column: int) -> bytes:
    """A log of which one column is so many times as large."""
    rows = (f"{k * 0.001:.3f},{k % 7},{k * 0.01:.2f}".split(",") for k in range(300))
    lines = (",".join(f"{cell}{scale}" if i == column else cell for i, cell in enumerate(row)) for row in rows)
    return "\n".join(("t,i,r", *lines, "")).encode()


SPOILED: dict[str, bytes] = {
    "a zero byte": LOG[:50] + b"\0" + LOG[50:],
    "torque of 1e-300": times("e-300", 1),
    "torque of 1e300": times("e300", 1),
    "times of 1e300": times("e300", 0),
    "a time of 1e300": b"t,i,r\n0,1,2\n1,3,4\n2,3,3\n1e300,2,2\n",
    "names only": b"t,i,r\n",
    "a program": b"\x7fELF\x02\x01\x01" + bytes(range(256)) * 40,
}


@pytest.fixture(scope="module")
def spoil(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes, str], Path]:
    folder = tmp_path_factory.mktemp("hostile")

    def write(content: bytes, name: str = "run.csv") -> Path:
        path = folder / name
        path.write_bytes(content)
        return path

    return write


@contextlib.contextmanager
def one_sentence_each() -> Iterator[list[str]]:
    """Accept what ends well, or in sentences that a terminal can be given; they are in the list afterwards."""
    sentences: list[str] = []
    try:
        yield sentences
    except JointidError as error:
        sentences += getattr(error, "faults", (str(error),))
        for said in sentences:
            assert said.isprintable(), said
            assert said[-1] in ".?", said
            assert 10 < len(said) < 5000, said


@pytest.mark.parametrize("name", ["torque of 1e-300", "torque of 1e300", "times of 1e300", "a time of 1e300"])
def test_numbers_that_nothing_measured_has_are_refused(spoil: Callable[..., Path], name: str) -> None:
    for resample in (None, Resampling(1e-3, "cubic")):
        with pytest.raises(RecordError):
            ji.read(spoil(SPOILED[name]), {"torque": "i", "reference": "r"}, resample=resample, kind="prismatic")


# Names


def test_no_name_reaches_the_terminal_as_a_command(
    capsys: pytest.CaptureFixture[str], spoil: Callable[..., Path]
) -> None:
    show("\x1b[2Jcleared \u202edrow\a\nnext line")
    assert capsys.readouterr().out == "\\x1b[2Jcleared \\u202edrow\\x07\nnext line\n"
    path = spoil(names_of(b"\x1b[31mi"))
    with pytest.raises(RecordError) as error:
        ji.read(path, {"torque": "other"}, kind="prismatic")
    assert '"\\x1b[31mi"' in str(error.value)
    assert len(short("a\nb" * 40)) == 40
    assert short("a\nb" * 40).isprintable()
    assert printable("plain ü °") == "plain ü °"


# Joint files and answers

JOINTS: dict[str, bytes] = {
    "cut": JOINT.encode()[:100],
    "a zero byte": JOINT.encode() + b"\0",
    "UTF-16": JOINT.encode("utf-16"),
    "too large a number": JOINT.replace("100.0", "1e400").encode(),
    "thousands of digits": JOINT.replace("100.0", "1" * 6000).encode(),
    "a key of half a megabyte": JOINT.encode() + b"y" * 500_000 + b" = 1\n",
    "brackets without end": JOINT.encode() + b"x = " + b"[" * 100_000 + b"\n",
    "tables within tables": JOINT.encode() + b"[" + b"a." * 50_000 + b"a]\n",
    "too many keys": JOINT.encode() + b"".join(b"k%d = 1\n" % k for k in range(50_000)),
    "megabytes": JOINT.encode() + b"#" * 2**21,
    "a zero byte in a path": JOINT.replace("run.csv", "a\\u0000b.csv").encode(),
    "too long a path": JOINT.replace("run.csv", f"{'x' * 300}.csv").encode(),
    "another folder": JOINT.replace("run.csv", "../../../../etc/passwd").encode(),
    "a device": JOINT.replace("run.csv", "/dev/zero").encode(),
    "a log": LOG,
}


@pytest.mark.parametrize("name", JOINTS)
def test_a_spoiled_joint_file_is_refused(spoil: Callable[..., Path], name: str) -> None:
    path = spoil(JOINTS[name], "joint.toml")
    with one_sentence_each() as said:
        load(path).record()
    assert 1 <= len(said) <= 1000


@pytest.mark.parametrize("name", ["a zero byte", "a program", "names only"])
def test_the_command_line_ends_in_a_sentence(
    spoil: Callable[..., Path], capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """A user's mistake is exit code 2, without a traceback."""
    spoil(SPOILED[name])
    assert _run(["identify", str(spoil(JOINT.encode(), "joint.toml")), "--quiet"], False) == 2
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err + printed.out
    assert (printed.err + printed.out).replace("\n", "").isprintable()
