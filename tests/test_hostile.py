"""Files of others: nothing in them is executed or steers the terminal, and a damaged one ends in one sentence."""

import gzip
import io
import pickle
import random
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli.app import _run
from jointid.apps.cli.console import show
from jointid.common.text import short
from jointid.output import json as answers
from jointid.records.formats import read_blocks, read_table
from jointid.records.resampling import Resampling
from tests.drawing import draw_seed
from tests.records.logged import LOGGED
from tests.rigid_axis import JOINT

Write = Callable[[Path], None]


def refused(read: Callable[[], object]) -> bool:
    """Whether a reading ends in sentences that a terminal can be given; it may also end well."""
    try:
        read()
    except ji.JointidError as error:
        for said in getattr(error, "faults", (str(error),)):
            assert said.isprintable() and 10 < len(said) < 5000, said
        return True
    return False


class _Executes:
    """What makes a folder when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return __import__("os").mkdir, ("executed",)


def _npy(header: str, rest: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + rest


def _archive(content: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("q.npy", content)
    return made.getvalue()


def _database(statement: str) -> Write:
    def write(path: Path) -> None:
        LOGGED["db3"].write(path)
        with sqlite3.connect(path) as base:
            base.execute(statement)
        base.close()

    return write


OBJECTS = "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }"
PICKLED = pickle.dumps(np.array([_Executes(), _Executes()], dtype=object))
CODE = '__import__("os").mkdir("executed")'
EXECUTING: dict[str, bytes | Write] = {
    "run.pkl": PICKLED,
    "run.pt": PICKLED,
    "header.npy": _npy(CODE),
    "objects.npy": _npy(OBJECTS, PICKLED),
    "objects.npz": _archive(_npy(OBJECTS, PICKLED)),
    "formula.csv": f"t,={CODE}\n0,1\n1,2\n".encode(),
    "value.jsonl": f'{{"t": [0, 1], "q": ["{CODE!r}", "{CODE!r}"]}}'.replace('("', "('").replace('")', "')").encode(),
    "qos.db3": _database("UPDATE topics SET offered_qos_profiles = '!!python/object/apply:os.mkdir [executed]'"),
    "definition.db3": _database(f"UPDATE message_definitions SET encoded_message_definition = 'float64 x={CODE}'"),
    "type.db3": _database(f"UPDATE topics SET type = 'a/msg/A''); {CODE}; ('"),
}  # fmt: skip


@pytest.mark.parametrize("name", EXECUTING)
def test_nothing_in_a_file_is_executed(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path, content = tmp_path / name, EXECUTING[name]
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    for read in (read_table, ji.inspect, lambda one: list(read_blocks(one, 10))):
        refused(lambda read=read: read(path))
    for name_of_other, load_other in (("joint.toml", ji.load), ("estimate.json", answers.read_report)):
        other = tmp_path / name_of_other
        other.write_bytes(path.read_bytes())
        assert refused(lambda load_other=load_other, other=other: load_other(other))
    assert not list(tmp_path.rglob("executed"))


def _chunk(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("q", shape=(2**27,), dtype="f8", chunks=(2**27 - 1,), compression="gzip")


def _mat(declared: int, held: int) -> bytes:
    begin = struct.pack("<II", 14, declared) + struct.pack("<4I", 6, 8, 6, 0) + struct.pack("<2I2i", 5, 8, 2**24, 1)
    return (
        b"MATLAB 5.0 MAT-file".ljust(124)
        + b"\x00\x01IM"
        + struct.pack("<II", 15, held)
        + zlib.compress(begin + struct.pack("<2H", 1, 1) + b"q\0\0\0" + struct.pack("<2I", 9, 2**27) + bytes(2**20))
    )


def _mcap(code: int, size: int) -> bytes:
    head = struct.pack("<BQ", 1, 12) + struct.pack("<I", 4) + b"ros2" + bytes(4)
    return b"\x89MCAP0\r\n" + head + struct.pack("<BQ", code, size) + bytes(99) + b"\x89MCAP0\r\n"


TOO_MUCH: dict[str, bytes | Write] = {
    "lists.jsonl": b"[" * 10**6 + b"]" * 10**6,
    "blanks.csv.gz": gzip.compress(b" " * 2**26, 9),
    "columns.csv": b",".join([b"q"] * 99_999) + b"\n" + b",".join([b"1"] * 99_999) + b"\n",
    "shape.npy": _npy("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 1000000000000), }", bytes(4096)),
    "nested.npy": _npy("(" * 5000),
    "declared.npz": _archive(_npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000,), }")),
    "chunk.h5": _chunk,
    "bomb.mat": _mat(2**32 - 1, 2**20),
    "chunk.mcap": _mcap(6, 2**62),
    "channel.mcap": _mcap(4, 2**31 - 1),
    "computed.db3": _database("CREATE VIEW v AS SELECT zeroblob(1000000000)"),
    "blob.db3": _database("UPDATE messages SET data = zeroblob(50000000) WHERE id = 1"),
    "array.db3": _database("UPDATE message_definitions SET encoded_message_definition = 'float64[1000000000] data'"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("name", TOO_MUCH)
def test_what_asks_for_too_much_is_read_or_refused(name: str, tmp_path: Path) -> None:
    path, content = tmp_path / name, TOO_MUCH[name]
    path.write_bytes(content) if isinstance(content, bytes) else content(path)
    refused(lambda: read_table(path))
    refused(lambda: ji.inspect(path))


def damaged(content: bytes, others: list[bytes], chance: random.Random) -> bytes:
    """Return a file with one to six damages: bits turned, parts cut, exchanged, or of another file, extreme numbers."""
    made = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        end = min(len(made), 2000) if chance.random() < 0.5 else len(made)
        at = chance.randrange(end) if end else 0
        size = chance.choice((1, 8, 64, 1000))
        match chance.randrange(6):
            case 0 if made:
                made[at] ^= 1 << chance.randrange(8)
            case 1:
                made[at : at + 8] = struct.pack("<q", chance.choice((0, -1, 2**31 - 1, 2**32 - 1, 2**62, -(2**63))))
            case 2:
                del made[at:]
            case 3:
                del made[at : at + size]
            case 4:
                made[at:at] = chance.choice((b"\0", b"\xff\xfe", b'"', b"1e400", b"nan", b"\x1b[2J", b"[", b"\n")) * 3
            case _:
                made[at : at + size] = chance.choice(others)[at : at + size]
    return bytes(made)


@pytest.mark.hostile
@pytest.mark.filterwarnings("ignore")  # what libraries say of a damaged file on the side
@pytest.mark.parametrize("name", LOGGED)
def test_a_damaged_file_of_any_format_is_read_or_refused(name: str, tmp_path: Path) -> None:
    whole, chance = dict[str, bytes](), random.Random(draw_seed(3))
    for kind, logged in LOGGED.items():
        path = tmp_path / f"{kind}{logged.suffix}"
        logged.write(path)
        whole[kind] = path.read_bytes()
    path, count = tmp_path / f"damaged{LOGGED[name].suffix}", 0
    renamed = [content for kind, content in whole.items() if kind != name]
    cuts = [whole[name][: len(whole[name]) * k // 8] for k in range(8)]
    bits = [damaged(whole[name], list(whole.values()), chance) for _ in range(20)]
    for content in (*renamed, *cuts, *bits):
        path.write_bytes(content)
        count += refused(lambda: read_table(path))
        refused(lambda: ji.inspect(path))
    assert count >= 5


HEAD = b"t,torque,reference\n"


def times(scale: bytes, column: int) -> bytes:
    """A log of which one column is so many times as large."""
    rows = ([b"%d" % k, b"%d" % (k % 7), b"%d" % (k % 5)] for k in range(300))
    lines = (b",".join(cell + scale if i == column else cell for i, cell in enumerate(row)) for row in rows)
    return HEAD + b"\n".join(lines) + b"\n"


NOT_MEASURED = {
    "torque of 1e-300": times(b"e-300", 1),
    "torque of 1e300": times(b"e300", 1),
    "times of 1e300": times(b"e300", 0),
    "a time of 1e300": HEAD + b"0,1,2\n1,3,4\n2,3,3\n1e300,2,2\n",
}


@pytest.mark.hostile
@pytest.mark.parametrize("resample", [None, Resampling(1e-3, "cubic")])
@pytest.mark.parametrize("name", NOT_MEASURED)
def test_numbers_that_nothing_measured_has_are_refused(name: str, resample: Resampling | None, tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_bytes(NOT_MEASURED[name])
    with pytest.raises(ji.RecordError):
        ji.read(path, {"torque": "torque", "reference": "reference"}, resample=resample, kind="prismatic")


def test_no_name_reaches_the_terminal_as_a_command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    show("\x1b[2Jcleared \u202edrow\a\nnext line: ü °")
    assert capsys.readouterr().out == "\\x1b[2Jcleared \\u202edrow\\x07\nnext line: ü °\n"
    assert len(short("a\nb" * 40)) == 40 and short("a\nb" * 40).isprintable()
    (tmp_path / "run.csv").write_bytes(b"t,\x1b[31mi,r\n0,1,2\n1,2,3\n")
    assert refused(lambda: ji.read(tmp_path / "run.csv", {"torque": "other"}, kind="prismatic"))


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
    "a zero byte in a path": JOINT.replace("run.npy", "a\\u0000b.csv").encode(),
    "too long a path": JOINT.replace("run.npy", f"{'x' * 300}.csv").encode(),
    "another folder": JOINT.replace("run.npy", "../../../../etc/passwd").encode(),
    "a device": JOINT.replace("run.npy", "/dev/zero").encode(),
    "a log": times(b"", 0),
}


@pytest.mark.hostile
@pytest.mark.parametrize("name", JOINTS)
def test_a_spoiled_joint_file_is_refused(name: str, tmp_path: Path) -> None:
    (tmp_path / "joint.toml").write_bytes(JOINTS[name])
    assert refused(lambda: ji.load(tmp_path / "joint.toml").record())


@pytest.mark.parametrize("log", [HEAD + b"\0" + HEAD, b"\x7fELF\x02\x01\x01" + bytes(range(256)), HEAD])
def test_the_command_line_ends_in_a_sentence(log: bytes, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A user's mistake is exit code 2, without a traceback."""
    (tmp_path / "run.csv").write_bytes(log)
    (tmp_path / "joint.toml").write_text(JOINT.replace("run.npy", "run.csv"))
    assert _run(["identify", str(tmp_path / "joint.toml"), "--quiet"], False) == 2
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err + printed.out
    assert (printed.err + printed.out).replace("\n", "").isprintable()
