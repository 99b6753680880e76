"""Files of others: whatever stands in a text format, a joint file or an answer, it is read or refused in a sentence.

Nothing in it is run, reaches the terminal as a command, or takes memory out of proportion.
"""

from __future__ import annotations

import contextlib
import json
import time
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jointid as ji
from jointid.apps.cli.app import _run
from jointid.apps.cli.console import show
from jointid.common.errors import JointidError, RecordError
from jointid.common.text import printable, short
from jointid.config import load, loads
from jointid.output import json as answers
from jointid.records.formats import Table, csv, read_blocks, read_table, write_table
from jointid.records.resampling import Resampling

pytestmark = pytest.mark.hostile

ROWS = "".join(f"{k * 0.001:.3f},{k % 7},{k * 0.01:.2f}\n" for k in range(300))
LOG = ("t,i,r\n" + ROWS).encode()
SCOPE = (
    b"Name\trun\nStarttime of export\t132959733843760000\n\nName\tA\tName\tB\nSampleTime[ms]\t1\tSampleTime[ms]\t1\n"
    b"Unit\t(None)\tUnit\tmm (Length)\n\n"
    + b"".join(b"%d\t%d,5\t%d\t%d\n" % (k, k, k, k) for k in range(50))
    + b"EOF\n"
)
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


SPOILED: dict[str, bytes] = {
    "cut in a number": LOG[:-3],
    "cut in a row": LOG[:-8],
    "a zero byte": LOG[:50] + b"\0" + LOG[50:],
    "zero bytes at the end": LOG + b"\0" * 1000,
    "zero bytes": b"\0" * 5000,
    "UTF-16": LOG.decode().encode("utf-16"),
    "UTF-16 without a mark": LOG.decode().encode("utf-16-le"),
    "UTF-16 cut in a character": LOG.decode().encode("utf-16")[:-1],
    "UTF-32": LOG.decode().encode("utf-32"),
    "a byte order mark": b"\xef\xbb\xbf" + LOG,
    "three ends of lines": LOG.replace(b"\n", b"\r\n", 50).replace(b"\n", b"\r", 80),
    "too large a number": LOG.replace(b"0.010,3", b"0.010,1e400"),
    "a column of nan": b"t,i,r\n0,nan,2\n1,nan,3\n",
    "an empty column": b"t,i,r\n0,,2\n1,,3\n",
    "a number of 20000 digits, and a letter": b"t,i\n0," + b"1" * 20_000 + b"x\n1,2\n",
    "rows of 8000 digits, and a letter": b"t,i\n" + (b"0," + b"1" * 8000 + b"x\n") * 20,
    "torque of 1e-300": (
        "t,i,r\n" + "".join(f"{k * 0.001:.3f},{k % 7}e-300,{k * 0.01:.2f}\n" for k in range(300))
    ).encode(),
    "torque of 1e300": (
        "t,i,r\n" + "".join(f"{k * 0.001:.3f},{k % 7}e300,{k * 0.01:.2f}\n" for k in range(300))
    ).encode(),
    "times of 1e300": ("t,i,r\n" + "".join(f"{k}e300,{k % 7},{k * 0.01:.2f}\n" for k in range(300))).encode(),
    "a time of 1e300": (b"t,i,r\n0,1,2\n1,3,4\n2,3,3\n1e300,2,2\n"),
    "a million digits": b"t,i\n0," + b"1" * 10**6 + b"\n1,2\n",
    "a line of megabytes": b"t,i\n0,1\n" + b"x" * 3 * 10**6 + b"\n1,2\n",
    "a first line of megabytes": b"x" * 3 * 10**6 + b"\nt,i\n0,1\n1,2\n",
    "a name of megabytes": b"x" * 2 * 10**6 + b",i\n0,1\n1,2\n",
    "a million numbers in a row": b"1 " * 2 * 10**6,
    "a million commas": b"," * 10**6 + b"\n0,1\n1,2\n",
    "a million quotes": b'"' * 10**6 + b"\n0,1\n1,2\n",
    "names without an end": b't,"i\n0,1\n1,2\n',
    "escapes": names_of(b"\x1b[31mi\x1b[0m"),
    "a bell": names_of(b"\x07"),
    "markup": names_of(b"<script>alert(1)</script>"),
    "right to left": names_of("\u202ei\u2066".encode()),
    "a formula": names_of(b"=cmd|' /C calc'!A0"),
    "a new line in a name": names_of(b'"a\nb"'),
    "half a character": names_of(b"\xed\xa0\x80"),
    "Latin-1": names_of(b"\xe9"),
    "one name twice": names_of(b"t"),
    "names only": b"t,i,r\n",
    "blanks only": b"   \n \n",
    "JSON": b'{"a": [1, 2]}',
    "a program": b"\x7fELF\x02\x01\x01" + bytes(range(256)) * 40,
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 40,
    "an archive": b"PK\x03\x04" + bytes(range(256)) * 40,
    "other digits": "t,i\n٠,١\n١,٢\n".encode(),
    "hexadecimal": b"t,i\n0x10,1\n0x11,2\n",
    "underscores": b"t,i\n1_0,1\n1_1,2\n",
    "thousands": b"t;i\n1.000,5;1\n2.000,5;2\n",
    "comments without end": b"#\n" * 50_000 + LOG,
    "a long comment": b"#" * 10**6 + b"\n" + LOG,
    "form feeds": b"t,i\x0bx,r\x0cy\n0,1,2\n1,2,3\n",
    "a delete in a number": b"t,i\n0,1\x7f\n1,2\n",
    "a scope without numbers": SCOPE[: SCOPE.index(b"\n\n0\t") + 1],
    "a scope cut off": SCOPE[:-9],
    "a scope of names": b"Name\ta\nStarttime of export\t1\nName\n",
    "a scope with an endless sample time": SCOPE.replace(b"SampleTime[ms]\t1", b"SampleTime[ms]\t1e999"),
    "a scope with no sample time": SCOPE.replace(b"SampleTime[ms]\t1", b"SampleTime[ms]\tnan"),
    "a scope with a stamp of twenty digits": SCOPE.replace(b"\n7\t", b"\n99999999999999999999\t"),
    "a scope with an escape": SCOPE.replace(b"\tA\t", b"\t\x1b[31mA\t"),
    "a scope with quotes between": SCOPE.replace(b"\t", b'"'),
    "a scope with zero bytes": SCOPE.replace(b"\t7,5\t", b"\t\0\t"),
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


@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_log_is_read_or_refused(spoil: Callable[..., Path], name: str) -> None:
    path = spoil(SPOILED[name])
    with one_sentence_each():
        assert read_table(path).columns
    with one_sentence_each():
        for block in read_blocks(path, 100):
            assert block.table().columns
    for unclear in ({"torque": "i", "reference": "r"}, {"torque": "no such"}):
        with one_sentence_each():
            record = ji.read(path, unclear, kind="prismatic")
            assert all(np.isfinite(channel.values).all() for _, channel in record.items())


@pytest.mark.parametrize("name", ["a number of 20000 digits, and a letter", "rows of 8000 digits, and a letter"])
def test_a_long_number_takes_no_longer_than_its_digits(spoil: Callable[..., Path], name: str) -> None:
    """A pattern that went back took the square of them, half a minute each."""
    begin = time.process_time()
    with one_sentence_each():
        read_table(spoil(SPOILED[name]))
    assert time.process_time() - begin < 3


@pytest.mark.parametrize("name", ["torque of 1e-300", "torque of 1e300", "times of 1e300", "a time of 1e300"])
def test_numbers_that_nothing_measured_has_are_refused(spoil: Callable[..., Path], name: str) -> None:
    for resample in (None, Resampling(1e-3, "cubic")):
        with pytest.raises(RecordError, match=r"expected 1e-30 to 1e\+30|which is no time"):
            ji.read(spoil(SPOILED[name]), {"torque": "i", "reference": "r"}, resample=resample, kind="prismatic")


def test_an_answer_without_end_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out.json").symlink_to("/dev/zero")
    with pytest.raises(RecordError, match="it is a pipe or a device, no file"):
        answers.read_report(tmp_path / "out.json")


def mutated(content: bytes) -> st.SearchStrategy[bytes]:
    """Return a file with bytes cut out, put in and repeated."""
    hostile = st.sampled_from(
        [b"\0", b"\xff\xfe", b'"', b"\n", b"\r", b"\t", b",", b";", b"1e400", b"nan", b"\x1b[2J", b"EOF"]
    )
    edit = st.tuples(st.integers(0, len(content)), st.integers(0, 40), st.one_of(hostile, st.binary(max_size=6)))

    def apply(edits: list[tuple[int, int, bytes]]) -> bytes:
        made = content
        for at, cut, put in edits:
            made = made[:at] + put + made[at + cut :]
        return made or b"x"

    return st.lists(edit, min_size=1, max_size=5).map(apply)


@settings(max_examples=150)
@given(st.one_of(mutated(LOG), mutated(SCOPE), st.binary(min_size=1, max_size=300)))
def test_any_bytes_are_read_or_refused(spoil: Callable[..., Path], content: bytes) -> None:
    path = spoil(content)
    with one_sentence_each():
        read_table(path)
    with one_sentence_each():
        for block in read_blocks(path, 64):
            block.table()
    with one_sentence_each():
        ji.read(path, {"torque": "i", "reference": "r"}, resample=Resampling(1e-3, "cubic"), kind="prismatic")


def test_10_000_columns_are_read_and_more_are_refused(
    spoil: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def wide(count: int) -> bytes:
        return (",".join(f"c{k}" for k in range(count)) + "\n" + (",".join(["1"] * count) + "\n") * 2).encode()

    assert len(read_table(spoil(wide(csv.WIDEST))).columns) == 10_000
    with pytest.raises(RecordError, match="10001 columns \\(at most 10000 are read\\)"):
        read_table(spoil(wide(csv.WIDEST + 1)))


# Memory


def peak_of(action: Callable[[], object]) -> int:
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_long_file_takes_the_memory_of_its_numbers(
    spoil: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A text is twice its numbers and more, as lines; read in blocks it needs a few times the numbers."""
    monkeypatch.setattr(csv, "_LONG", 10**6)
    monkeypatch.setattr(csv, "_LONG_BLOCK", 5000)
    rows = 40_000
    path = spoil(
        b"t,i,r,q\n" + b"0.123456789012345678,1.2345678901234567,2.3456789012345678,3.4567890123456789\n" * rows
    )
    numbers = rows * 4 * 8
    found: list[Table] = []
    assert peak_of(lambda: found.append(csv.Csv().read(path))) < 4 * numbers
    assert found[0].columns["q"].size == rows
    monkeypatch.setattr(csv, "_LONG", 10**9)
    assert peak_of(lambda: csv.Csv().read(path)) > 4 * numbers  # what it was before


def test_pieces_of_a_long_file_take_the_memory_of_a_piece(spoil: Callable[..., Path]) -> None:
    def peak(rows: int) -> int:
        path = spoil(b"i,r\n" + b"1.2345678901234567,2.3456789012345678\n" * rows)
        return peak_of(lambda: sum(block.rows for block in read_blocks(path, 1000)))

    assert peak(40_000) < 1.5 * peak(5_000)


def test_a_file_that_is_one_line_is_not_read_to_its_end(spoil: Callable[..., Path]) -> None:
    path = spoil(b"1" * 20_000_000)

    def look() -> None:
        with pytest.raises(RecordError, match="line 1 has more than 2500000 characters"):
            next(read_blocks(path, 10))

    assert peak_of(look) < 15_000_000


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


@pytest.mark.parametrize("name", ["=cmd|' /C calc'!A0", "@SUM(A1)", "+1+cmd|'/C calc'!A0", "-2+3+cmd|'/C calc'!A0"])
def test_no_formula_is_written_for_a_spreadsheet(tmp_path: Path, name: str) -> None:
    """What is written must be read back as it was, so that such a name is refused, not changed."""
    with pytest.raises(RecordError, match="by which spreadsheet programs know a formula"):
        write_table(tmp_path / "run.csv", Table({"t": np.arange(2.0), name: np.arange(2.0)}))
    assert not (tmp_path / "run.csv").exists()
    write_table(tmp_path / "run.npy", Table({"t": np.arange(2.0), name: np.arange(2.0)}))


# Joint files and answers

JOINTS: dict[str, bytes] = {
    "cut": JOINT.encode()[:100],
    "a zero byte": JOINT.encode() + b"\0",
    "UTF-16": JOINT.encode("utf-16"),
    "Latin-1": JOINT.encode() + b"# \xe9\n",
    "too large a number": JOINT.replace("100.0", "1e400").encode(),
    "no number": JOINT.replace("100.0", "nan").encode(),
    "thousands of digits": JOINT.replace("100.0", "1" * 6000).encode(),
    "a number of 4000 digits": JOINT.replace("100.0", "1" * 4000).encode(),
    "a key of half a megabyte": JOINT.encode() + b"y" * 500_000 + b" = 1\n",
    "brackets without end": JOINT.encode() + b"x = " + b"[" * 100_000 + b"\n",
    "tables within tables": JOINT.encode() + b"[" + b"a." * 50_000 + b"a]\n",
    "too many keys": JOINT.encode() + b"".join(b"k%d = 1\n" % k for k in range(50_000)),
    "too many tables": JOINT.encode() + b"".join(b"[t%d]\n" % k for k in range(50_000)),
    "too many records": JOINT.encode() + b"[[records]]\nfile = 1\n" * 40_000,
    "megabytes": JOINT.encode() + b"#" * 2**21,
    "an escape": JOINT.replace("cascade", "casc\\u001b[31made").encode(),
    "right to left": JOINT.replace("cascade", "\u202ecascade").encode(),
    "a zero byte in a path": JOINT.replace("run.csv", "a\\u0000b.csv").encode(),
    "too long a path": JOINT.replace("run.csv", f"{'x' * 300}.csv").encode(),
    "another folder": JOINT.replace("run.csv", "../../../../etc/passwd").encode(),
    "a device": JOINT.replace("run.csv", "/dev/zero").encode(),
    "a log": LOG,
    "any bytes": bytes(range(256)) * 50,
}


@pytest.mark.parametrize("name", JOINTS)
def test_a_spoiled_joint_file_is_refused(spoil: Callable[..., Path], name: str) -> None:
    path = spoil(JOINTS[name], "joint.toml")
    with one_sentence_each() as said:
        load(path).record()
    assert 1 <= len(said) <= 1000


@settings(max_examples=150)
@given(mutated(JOINT.encode()))
def test_a_joint_file_of_any_bytes_is_read_or_refused(spoil: Callable[..., Path], content: bytes) -> None:
    with one_sentence_each():
        load(spoil(content, "joint.toml"))


def test_an_endless_device_is_no_file(tmp_path: Path) -> None:
    link = tmp_path / "run.csv"
    link.symlink_to("/dev/zero")
    with pytest.raises(RecordError, match="is a pipe or a device; write what it gives to a file"):
        read_table(link)


VALUES = {"inertia": ("kg", 1.0), "viscous": ("N s/m", 1.0), "coulomb": ("N", 1.0), "offset": ("N", 1.0)}
ANSWER = {
    "schema": "jointid.estimate/1", "model": "rigid", "kind": "prismatic", "friction": "symmetric", "gravity": None,
    "transmission": None, "method": "didim", "delay": 0.0, "controller_sha256": "", "effects": [],
    "record": {"name": "run", "torque_sha256": "x"},
    "parameters": {name: {"value": value, "unit": unit} for name, (unit, value) in VALUES.items()},
    "filtering": {
        "position_cutoff": 1.0, "cutoff": 1.0, "decimation": 1, "borders": [0, 0], "timing": "respected",
        "aliasing": "refused",
    },
}  # fmt: skip
WRITTEN = json.dumps(ANSWER).encode()

SPOILED_ANSWERS: dict[str, bytes] = {
    "cut": WRITTEN[:200],
    "empty": b"",
    "zero bytes": b"\0" * 10,
    "a list": b"[]",
    "brackets without end": b"[" * 200_000,
    "not a number": WRITTEN.replace(b"1.0", b"NaN"),
    "endless": WRITTEN.replace(b'"value": 1.0', b'"value": 1e999'),
    "thousands of digits": b'{"schema": 1' + b"0" * 5000 + b"}",
    "UTF-16": WRITTEN.decode().encode("utf-16"),
    "parameters in a list": WRITTEN.replace(b'"parameters": {', b'"parameters": [{').replace(b'"filtering"', b'"f"'),
    "tables for words": b'{"schema": "jointid.estimate/1", "model": [], "kind": {}, "parameters": {}, "effects": 5}',
    "an escape": b'{"transmission": {"side": "\\u001b[31m", "motor_per_load": "x\\n"}}',
    "a number of 401 digits": WRITTEN.replace(b'"value": 1.0', b'"value": 1' + b"0" * 400),
    "a delay of 401 digits": WRITTEN.replace(b'"delay": 0.0', b'"delay": -1' + b"0" * 400),
    "a border of 401 digits": WRITTEN.replace(b"[0, 0]", b"[0, 1" + b"0" * 400 + b"]"),
    "another method": WRITTEN.replace(b'"didim"', b'"__import__"'),
}


@pytest.mark.parametrize("name", SPOILED_ANSWERS)
def test_a_spoiled_answer_is_refused(spoil: Callable[..., Path], name: str) -> None:
    file = loads(JOINT)
    path = spoil(SPOILED_ANSWERS[name], "out.json")
    with one_sentence_each() as said:
        answers.load_estimate(path, file)
    assert len(said) == 1


@settings(max_examples=100)
@given(mutated(WRITTEN))
def test_an_answer_of_any_bytes_is_read_or_refused(spoil: Callable[..., Path], content: bytes) -> None:
    file = loads(JOINT)
    with one_sentence_each():
        found = answers.load_estimate(spoil(content, "out.json"), file)
        assert all(np.isfinite(value) for value in found.values.values())


@pytest.mark.parametrize(
    "name", ["a zero byte", "escapes", "a program", "a formula", "too large a number", "names only"]
)
def test_the_command_line_ends_in_a_sentence(
    spoil: Callable[..., Path], capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """A user's mistake is exit code 2, without a traceback."""
    spoil(SPOILED[name])
    assert _run(["identify", str(spoil(JOINT.encode(), "joint.toml")), "--quiet"], False) == 2
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err + printed.out
    assert (printed.err + printed.out).replace("\n", "").isprintable()
