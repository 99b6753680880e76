"""Hostile files made by hand: each knows what a reader does, and asks it for too much."""

from __future__ import annotations

import gzip
import io
import json
import sqlite3
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np

from tests.attack.samples import ANSWER, JOINT, ROWS, TEXTS, Sample
from tests.losses.runs import EXECUTED
from tests.records.logged import LOGGED

_SCOPE = TEXTS["scope.csv"].decode()
_HUGE = (10**9, 2**31 - 1, 2**32 - 1, 2**48, 2**63 - 1)


def make_hostile(folder: Path) -> Iterator[Sample]:
    """Yield all of them."""
    for make in (_texts, _arrays, _packed, _mats, _hdf5, _bags, _tables, _joints, _answers, _pages):
        for name, content in make(folder):
            is_answer = name.endswith((".json", ".html")) and make is not _packed
            reader = "joint" if name.endswith(".toml") else "answer" if is_answer else "record"
            yield Sample(reader, name, content.encode() if isinstance(content, str) else content)


def _texts(_: Path) -> Iterator[tuple[str, str | bytes]]:
    for number, digits in enumerate((100, 5000, 20_000, 200_000)):
        long = "1" * digits
        for place, text in {
            "cell": f"t,i\n0,{long}\n1,2\n",
            "bad cell": f"t,i\n0,{long}x\n1,2\n",
            "point": f"t,i\n0,{long}.{long}.\n1,2\n",
            "exponent": f"t,i\n0,1e{long}\n1,2\n",
            "row": f"t,i\n0,1\n{long}\n",
            "first row": f"{long}x\n0,1\n1,2\n",
            "comma": f"t;i\n0;{'1,' * (digits // 2)}\n1;2\n",
            "quoted": f't,i\n0,"{long}"\n1,2\n',
            "name": f"t,{long}x\n0,1\n1,2\n",
            "unit": f"t,i\ns,[{long}]\n0,1\n1,2\n",
            "signs": f"t,i\n0,{'+' * digits}\n1,2\n",
            "brackets": f"t,{'(' * digits}\n0,1\n1,2\n",
            "comment": f"{'#' * digits}\nt,i\n0,1\n1,2\n",
            "blanks": f"t,i\n0,{' ' * digits}1\n1,2\n",
            "quotes": f"t,i\n0,{chr(34) * digits}\n1,2\n",
        }.items():
            yield f"a long {place} {number}.csv", text
    for digits in (400, 8000):
        for bad in ("", "x", ".", "e", ",1", "e+"):
            yield f"rows of {digits} digits{bad.replace('.', 'p')}.csv", "t,i\n" + f"0,{'1' * digits}{bad}\n" * 20
    for width in (1000, 9_999, 99_999):
        names, row = ",".join(f"c{k}" for k in range(width)), ",".join(["1"] * width)
        yield f"{width} columns.csv", f"{names}\n{row}\n{row}\n"
        yield f"{width} columns of one name.csv", f"{','.join(['q'] * width)}\n{row}\n{row}\n"
        yield f"{width} columns without names.csv", f"{row}\n{row}\n"
        yield f"{width} columns and a bad cell.csv", f"{names}\n{row}\n{row}x\n"
        yield f"{width} quoted columns.csv", f"{names}\n" + f"{','.join(['{0}1{0}'.format(chr(34))] * width)}\n" * 2
        clocks = ",".join(f"a{k}/time" for k in range(width))
        yield f"{width} clocks.csv", f"{clocks}\n" + "".join(f"{','.join([str(k)] * width)}\n" for k in range(3))
    for groups in (100, 1000, 10_000):
        head = "Name\trun\nStarttime of export\t132959733843760000\n\n" + "\t".join(
            f"Name\tA{k}" for k in range(groups)
        )
        times = "\t".join(["SampleTime[ms]\t1"] * groups)
        for value in ("1", "132959733843760000", "9" * 20, "1e999", "nan"):
            row = "\t".join([value, "1"] * groups)
            yield f"a scope of {groups} groups at {value[:4]}.csv", f"{head}\n{times}\n{row}\n{row}\nEOF\n"
    lengths = "".join("\t".join(["1" if k < g else "" for g in range(300) for _ in "ab"]) + "\n" for k in range(300))
    yield (
        "a scope of 300 lengths.csv",
        (
            "Name\trun\nStarttime of export\t1\n\n"
            + "\t".join(f"Name\tA{k}" for k in range(300))
            + "\n"
            + "\t".join(["SampleTime[ms]\t1"] * 300)
            + "\n"
            + lengths
            + "EOF\n"
        ),
    )
    for mark in ('"', "\0", "\x1b[2J", "\u202e", "\x0c", "\x85", "\u2028"):
        yield f"a scope split by {ord(mark[0])}.csv", _SCOPE.replace("\t", mark)
        yield f"a text split by {ord(mark[0])}.csv", f"t,i,r\n{ROWS}".replace(",", mark)
    for torque, time in (("1e-300", "1e-3"), ("1e300", "1e-3"), ("1", "1e300"), ("1", "1e-300"), ("1e-310", "1e305")):
        rows = "".join(f"{k}{time[1:]},{k % 7}{torque[1:]},{k % 5}{torque[1:]}\n" for k in range(100))
        yield f"torque of {torque}, times of {time}.csv", f"t,i,r\n{rows}"
    yield "half a million empty lines.csv", "\n" * 500_000 + "t,i\n0,1\n1,2\n"
    yield "half a million comments.csv", "#\n" * 500_000 + "t,i\n0,1\n1,2\n"
    yield "two megabytes of ones.csv", "1\n" * 1_000_000
    yield "three megabytes of ones.csv", "1\n" * 1_500_000
    yield "three megabytes and a quote.csv", "1\n" * 1_500_000 + '"\n'


def _npy(header: str, rest: bytes = b"", version: bytes = b"\x01\x00") -> bytes:
    size = struct.pack("<H" if version[0] == 1 else "<I", len(header))
    return b"\x93NUMPY" + version + size + header.encode("latin-1") + rest


def _arrays(_: Path) -> Iterator[tuple[str, bytes]]:
    for number, shape in enumerate(
        (
            "(3,)",
            "(3,3)",
            "(0,)",
            "(-1,)",
            "(3,-1)",
            "(1.5,)",
            "('a',)",
            "3",
            "()",
            "(3,3,3)",
            "(True,)",
            *(f"({n},)" for n in _HUGE),
            *(f"(3,{n})" for n in _HUGE),
            f"({10**400},)",
            f"(3,{10**400})",
            "(2,100000)",
            "(1,250000)",
        ),
    ):
        for kind in ("'<f8'", "'|u1'", "'|O'", "[('a','<f8'),('b','<f8')]", "'<M8[s]'", "'|V1000000'"):
            header = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}\n"
            yield f"shape {number} of {len(kind)}.npy", _npy(header, bytes(2_000_000 if "0000)" in shape else 4096))
    for number, header in enumerate(
        (
            "(" * 5000,
            "[" * 60_000,
            "{'descr': " * 500,
            f"__import__('os').system('touch {EXECUTED}')",
            "{}",
            "{'shape': (3,)}",
            "1" * 60_000,
            "-" * 60_000,
            "{'descr': '<f8', 'fortran_order': 0, 'shape': (3,)}",
            "'" * 3000,
            "{**{}}",
            "9**9**9",
        ),
    ):
        for version in (b"\x01\x00", b"\x02\x00", b"\x03\x00"):
            yield f"header {number} of version {version[0]}.npy", _npy(header, bytes(100), version)
    fields = ",".join(f"('c{k}','<f8')" for k in range(40_000))
    for count in (1, 10**9):
        header = f"{{'descr': [{fields}], 'fortran_order': False, 'shape': ({count},), }}\n"
        yield f"40000 fields, {count} rows.npy", _npy(header, bytes(320_000), b"\x02\x00")


def _packed(_: Path) -> Iterator[tuple[str, bytes]]:
    """Archives and packed texts that unpack to far more than they are, and JSON without an end."""
    for name, text in (("blanks", b" " * 2**26), ("rows", b"t,i\n" + b"0,1\n" * 2**19), ("one line", b"1" * 2**26)):
        yield f"{name}.csv.gz", gzip.compress(text, 9)
        yield f"{name}.json.gz", gzip.compress(text, 9)
    for depth in (100, 10_000, 1_000_000):
        yield f"{depth} lists.json", b"[" * depth + b"]" * depth
        yield f"{depth} records.json", b'{"a":' * depth + b"1" + b"}" * depth
        yield f"{depth} lists on a line.jsonl", b"1\n" + b"[" * depth + b"]" * depth
    for number, text in enumerate(
        (b"[1e999, 1]", b'{"a": [1, 1e400]}', b"[" + b"9" * 5000 + b", 1]", b'[{"a": 1, "a": 2}]', b'{"a": "\xff"}',
         b"[]",
         b"null", b"[[1, 2], [3]]", b'[{"a": 1}, 5]', b'{"": [1, 2], "b.c": [1], "b": {"c": [2, 3]}}')
    ):  # fmt: skip
        yield f"value {number}.json", text
    for number, (header, rest, declared) in enumerate(
        (
            ("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000,), }", b"", None),
            (
                "{'descr': '|O', 'fortran_order': False, 'shape': (2,), }",
                f"cos\nsystem\n(S'touch {EXECUTED}'\ntR.".encode(),
                None,
            ),
            ("{'descr': '|u1', 'fortran_order': False, 'shape': (268435456,), }", bytes(2**28), None),
            ("{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3), }", bytes(240), None),
            ("{'descr': '<f8', 'fortran_order': False, 'shape': (30,), }", bytes(240), 10**12),
        )
    ):
        image = io.BytesIO()
        with zipfile.ZipFile(image, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("q.npy", _npy(header, rest))
        content = image.getvalue()
        if declared is not None:  # in the central directory
            place = content.index(b"PK\x01\x02") + 24
            content = content[:place] + struct.pack("<I", declared % 2**32) + content[place + 4 :]
        yield f"archive {number}.npz", content


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def _matrix(name: bytes, dims: bytes, content: bytes, kind: int = 6, numbers: int = 5) -> bytes:
    parts = _element(6, struct.pack("<II", kind, 0)) + _element(numbers, dims) + _element(1, name) + content
    return _element(14, parts)


def _mats(_: Path) -> Iterator[tuple[str, bytes]]:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
    five = _element(9, np.ones(5).tobytes())
    sound = _matrix(b"q", struct.pack("<ii", 5, 1), five)
    for number, dims in enumerate(
        ((np.inf, 1), (np.nan, 1), (-np.inf, 1), (1e300, 1), (5, 1e-300), (5.5, 1), (-5, -1))
    ):
        packed = np.array(dims, dtype="<f8").tobytes()
        yield f"dimensions as floats {number}.mat", head + sound + _matrix(b"r", packed, five, numbers=9)
        yield f"dimensions of a structure {number}.mat", head + sound + _matrix(b"s", packed, b"", kind=2, numbers=9)
    for number, sizes in enumerate(
        ((2**31 - 1, 1), (2**31 - 1,) * 2, (-1, -5), (0, 0), (5,), (1,) * 30, (2**31 - 1,) * 60)
    ):
        packed = struct.pack(f"<{len(sizes)}i", *sizes)
        yield f"dimensions {number}.mat", head + _matrix(b"q", packed, five)
        yield (
            f"dimensions of structures {number}.mat",
            head + _matrix(b"s", packed, _element(5, struct.pack("<i", 8)) + _element(1, b"a\0\0\0\0\0\0\0"), kind=2),
        )
    yield "two of one name.mat", head + sound + sound
    for length in (0, 1, -8, 2**31 - 1):
        names = _element(5, struct.pack("<i", length)) + _element(1, b"a\0\0\0\0\0\0\0") + sound
        yield f"names of {length} bytes.mat", head + _matrix(b"s", struct.pack("<ii", 1, 1), names, kind=2)
    deep = sound
    for _level in range(3000):
        deep = _matrix(
            b"", struct.pack("<ii", 1, 1), _element(5, struct.pack("<i", 8)) + _element(1, b"a" + bytes(7)) + deep, 2
        )
    yield "structures within structures.mat", head + _matrix(b"s", struct.pack("<ii", 1, 1), deep[48:], 2)
    for size in (2**27, 2**29):
        for told in (size + 56, 64, 2**32 - 1):
            begin = struct.pack("<II", 14, told) + sound[8:32] + _element(1, b"q") + struct.pack("<II", 9, size)
            packing = zlib.compressobj(9)
            packed = packing.compress(begin) + b"".join(packing.compress(bytes(2**22)) for _ in range(size // 2**22))
            packed += packing.flush()
            yield f"a bomb of {size} that says {told}.mat", head + struct.pack("<II", 15, len(packed)) + packed
    yield (
        "many variables.mat",
        head + b"".join(_matrix(b"v%d" % k, struct.pack("<ii", 5, 1), five) for k in range(18_000)),
    )
    for number, row in enumerate(
        ((0, 5, 1, 0, 2), (0, -5, 1, 0, 2), (0, 2**31 - 1, 2**31 - 1, 0, 2), (0, 5, 1, 0, 2**31 - 1), (99, 5, 1, 0, 2))
    ):
        yield f"version 4 {number}.mat", struct.pack("<5i", *row) + b"q\0" + bytes(40)


def _hdf5_file(fill: Callable[[h5py.File], object], folder: Path, userblock: int = 0) -> bytes:
    path = folder / "made.h5"
    with h5py.File(path, "w", userblock_size=userblock) as file:
        fill(file)
    return path.read_bytes()


def _hdf5(folder: Path) -> Iterator[tuple[str, bytes]]:
    def dataset(shape: tuple[int, ...], kind: str, chunks: tuple[int, ...] | None) -> bytes:
        how = {} if chunks is None else {"chunks": chunks, "compression": "gzip"}
        return _hdf5_file(lambda file: file.create_dataset("q", shape=shape, dtype=kind, **how), folder)

    for rows in (10**7, 10**8, 10**11, 2**40):
        for kind in ("f8", "u1"):
            yield f"{rows} rows of {kind} that are nowhere.h5", dataset((rows,), kind, (2**16,))
    yield "a chunk of a gigabyte.h5", dataset((2**27,), "f8", (2**27 - 1,))
    yield "a million columns.h5", dataset((3, 10**6), "f8", (3, 1000))
    yield "a thousand columns.h5", dataset((10**6, 1000), "f8", (100, 1000))

    def many(count: int) -> Callable[[h5py.File], None]:
        def fill(file: h5py.File) -> None:
            for k in range(count):
                file[f"d{k}"] = 1.0

        return fill

    yield "5000 datasets.h5", _hdf5_file(many(5000), folder)

    def deep(file: h5py.File) -> None:
        group = file
        for _level in range(1500):
            group = group.create_group("a")
        group["q"] = np.ones(3)

    yield "groups within groups.h5", _hdf5_file(deep, folder)

    def ring(file: h5py.File) -> None:
        for k in range(30):
            file.create_group(f"g{k}")
        for k in range(30):
            for other in range(30):
                file[f"g{k}/h{other}"] = file[f"g{other}"]
        file["q"] = np.ones(3)

    yield "groups that hold each other.h5", _hdf5_file(ring, folder)

    def references(file: h5py.File) -> None:
        file["#refs#/a"] = np.ones((1, 3))
        file["#refs#/a"].attrs["MATLAB_class"] = np.bytes_("double")
        group = file.create_group("s")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for k in range(4):
            group[f"f{k}"] = np.array([[file["#refs#/a"].ref] * 4500], dtype=h5py.ref_dtype)

    yield "18000 references.mat", _hdf5_file(references, folder, 512)

    def own(file: h5py.File) -> None:
        group = file.create_group("s")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        group["f"] = np.array([[group.ref] * 40], dtype=h5py.ref_dtype)

    yield "references to what holds them.mat", _hdf5_file(own, folder, 512)

    def units(file: h5py.File) -> None:
        file["q"] = np.ones(3)
        file["q"].attrs["units"] = "m" * 60_000
        file["r"] = np.ones(3)
        file["r"].attrs["units"] = np.bytes_(b"\x1b[2J\xff\xfe")

    yield "units of kilobytes.h5", _hdf5_file(units, folder)


def _database(folder: Path, *statements: str) -> bytes:
    path = folder / "made.db3"
    path.unlink(missing_ok=True)
    LOGGED["db3"].write(path)
    with sqlite3.connect(path) as base:
        for one in statements:
            base.execute(one)
    base.close()
    return path.read_bytes()


def _bags(folder: Path) -> Iterator[tuple[str, bytes]]:
    count = "WITH RECURSIVE n(i) AS (SELECT 10 UNION ALL SELECT i + 1 FROM n WHERE i < {})"
    kind = "std_msgs/msg/Float64"
    for number in (100, 3000, 30_000):
        yield (
            f"{number} topics.db3",
            _database(
                folder, f"INSERT INTO topics {count.format(number)} SELECT i, '/t' || i, '{kind}', 'cdr', '', '' FROM n"
            ),
        )
    for number, statement in enumerate(
        (
            "CREATE VIEW v AS SELECT zeroblob(1000000000)",
            "CREATE TABLE g(a, b BLOB AS (zeroblob(1000000000)))",
            "CREATE TRIGGER t AFTER INSERT ON topics BEGIN SELECT 1; END",
            "UPDATE messages SET data = zeroblob(50000000) WHERE id = 1",
            "UPDATE topics SET name = zeroblob(1000000)",
            "UPDATE topics SET type = ''",
            "UPDATE topics SET type = 'a/b/c/d'",
            "UPDATE topics SET offered_qos_profiles = '&a [*a, *a]'",
            f"UPDATE topics SET offered_qos_profiles = '!!python/object/apply:os.system [touch {EXECUTED}]'",
            "UPDATE messages SET timestamp = 9223372036854775807",
            "UPDATE messages SET timestamp = -9223372036854775808",
            "UPDATE messages SET timestamp = 1e300",
            "UPDATE messages SET timestamp = 'now'",
            "UPDATE messages SET topic_id = 99",
            "UPDATE message_definitions SET encoded_message_definition = 'float64[1000000000] data'",
            "UPDATE message_definitions SET encoded_message_definition = 'A a' || char(10) || '=== MSG: my/A'",
            "UPDATE message_definitions SET encoded_message_definition = zeroblob(100000)",
            "UPDATE message_definitions SET encoding = 'no such'",
            "DELETE FROM message_definitions",
            "DROP TABLE message_definitions",
            "DROP TABLE messages",
            "ALTER TABLE messages RENAME COLUMN data TO dates",
            "CREATE INDEX i ON messages (abs(timestamp))",
        )
    ):
        yield f"a database {number}.db3", _database(folder, statement)
    definitions = (
        "float64 a\n" * 20_000,
        "(" * 20_000,
        "#" * 100_000,
        "string<=" * 10_000,
        "float64 a = " + "1" * 20_000,
    )
    for number, text in enumerate(definitions):
        yield (
            f"a definition {number}.db3",
            _database(folder, f"UPDATE message_definitions SET encoded_message_definition = '{text}'"),
        )
    magic = b"\x89MCAP0\r\n"

    def record(code: int, content: bytes) -> bytes:
        return struct.pack("<BQ", code, len(content)) + content

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    head = record(1, text(b"ros2") + text(b""))
    tail = record(15, bytes(4)) + record(2, bytes(20)) + magic
    for size in _HUGE:
        for code in (1, 3, 4, 5, 6, 7, 8):
            yield (
                f"record {code} of {size} bytes.mcap",
                magic + head + struct.pack("<BQ", code, size) + bytes(99) + tail,
            )
    packed = zlib.compress(bytes(10**6))
    for name in (b"", b"lz4", b"zstd", b"rot13"):
        for size in (10, 10**6, 2**40):
            chunk = struct.pack("<QQQI", 0, 0, size, 0) + text(name) + struct.pack("<Q", len(packed)) + packed
            yield f"a chunk {name.decode()} of {size}.mcap", magic + head + record(6, chunk) + tail
    for name, packed in (("lz4", _lz4(10**9)), ("zstd", _zstd(10**9))):
        for size in (10**6, 10**9, 2**40):
            chunk = struct.pack("<QQQI", 0, 0, size, 0) + text(name.encode()) + struct.pack("<Q", len(packed)) + packed
            yield f"a bomb {name} that says {size}.mcap", magic + head + record(6, chunk) * 3 + tail


def _lz4(size: int) -> bytes:
    from lz4.frame import LZ4FrameCompressor

    packing = LZ4FrameCompressor(compression_level=3)
    return packing.begin() + b"".join(packing.compress(bytes(10**7)) for _ in range(size // 10**7)) + packing.flush()


def _zstd(size: int) -> bytes:
    if sys.version_info >= (3, 14):
        from compression.zstd import ZstdCompressor
    else:
        from backports.zstd import ZstdCompressor
    packing = ZstdCompressor()
    return b"".join(packing.compress(bytes(10**7)) for _ in range(size // 10**7)) + packing.flush()


def _tables(folder: Path) -> Iterator[tuple[str, bytes]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    def parquet(table: pa.Table) -> bytes:
        made = io.BytesIO()
        pq.write_table(table, made)
        return made.getvalue()

    yield "a constant column of ten million.parquet", parquet(pa.table({"q": np.zeros(10_000_000)}))
    yield "two thousand columns.parquet", parquet(pa.table({f"c{k}": np.zeros(3) for k in range(2000)}))
    nested = pa.array([1.0, 2.0])
    for _level in range(60):
        nested = pa.StructArray.from_arrays([nested], ["a"])
    yield "structures within structures.parquet", parquet(pa.table({"q": nested}))
    for number, kind in enumerate(
        (pa.timestamp("ns"), pa.decimal128(38, 10), pa.float16(), pa.time64("us"), pa.uint64())
    ):
        yield (
            f"type {number}.parquet",
            parquet(
                pa.table(
                    {"q": pa.array([0, 1, None], pa.int64()).cast(kind, safe=False)}
                    if kind != pa.float16()
                    else {"q": pa.array(np.ones(3, dtype="f2"))}
                )
            ),
        )
    path = folder / "made.tdms"
    LOGGED["tdms"].write(path)
    content = path.read_bytes()
    for at in range(4, 60, 4):
        for number in (0xFFFFFFFF, 0x7FFFFFFF):
            yield f"a number at {at} is {number}.tdms", content[:at] + struct.pack("<I", number) + content[at + 4 :]


def _joints(_: Path) -> Iterator[tuple[str, str | bytes]]:
    for count in (300, 20_000, 120_000):
        for number, text in enumerate(
            (
                f"x{'.a' * count} = [1, 2]\n",
                f"[x{'.a' * count}]\n",
                f"x = {{ y{'.a' * count} = 1 }}\n",
                f"x = {'[' * count}\n",
                f"x = {'{a=' * count}\n",
                f"x = {'[' * count}{']' * count}\n",
                f"x = {'1' * count}\n",
                f"x = 0.{'1' * count}\n",
                f'x = "{chr(92) * count}\n',
                f"x = '''{chr(39) * 2 * (count // 3)}\n",
                f'x = """{chr(34) * 2}a{chr(34)}\n' * 3,
                f"x = 1{'_1' * count}\n",
                f"{'a' * count} = 1\n",
                f"x = 2020-01-01{'T' * count}\n",
                "[a]\n" * count,
                "x = [\n" + "[1],\n" * count + "]\n",
                "".join(f"[[k{k}]]\n" for k in range(min(count, 40_000))),
                "\n" * count,
                f"x = {'-' * count}1\n",
                f"x = {{ {'a = 1, ' * count} }}\n",
                f"{chr(34)}{'.' * count}{chr(34)} = 1\n",
            ),
        ):
            yield f"text {number} of {count}.toml", JOINT + text
    for number, change in enumerate(
        (
            ("100.0", "1" + "0" * 400),
            ("100.0", "-1" + "0" * 400),
            ("100.0", "1e-300"),
            ("100.0", "1e300"),
            ("100.0", "inf"),
            ("40.0", "1e-300"),
            ("40.0", "1e300"),
            ("80.0", "1" + "0" * 400),
            ("0.0\n", "[[]]\n"),
            ('"didim"', '"__import__"'),
            ('"run.csv"', '"/dev/zero"'),
            ('"run.csv"', '"' + "a/" * 5000 + '"'),
            ('"run.csv"', '""'),
            ('"cascade"', "[]"),
            ('{ kind = "notch", frequency = 80.0, bandwidth = 20.0 }', "{ numerator = [" + "1.0, " * 50_000 + "] }"),
            ('{ kind = "notch", frequency = 80.0, bandwidth = 20.0 }', "{ numerator = [1" + "0" * 400 + "] }"),
            (
                '{ kind = "notch", frequency = 80.0, bandwidth = 20.0 }',
                '{ kind = "moving_average", samples = 1000000000 }',
            ),
        ),
    ):
        yield f"change {number}.toml", JOINT.replace(*change, 1)
    yield "a megabyte of points.toml", JOINT + "".join(f"[{'a.' * 250}k{k}]\n" for k in range(1800))


def _answers(_: Path) -> Iterator[tuple[str, str | bytes]]:
    sound = json.dumps(ANSWER)
    wrong = (
        "1" + "0" * 400,
        "-1" + "0" * 400,
        "1e400",
        "-1e400",
        "NaN",
        "1e-400",
        "null",
        "[]",
        "{}",
        '"x"',
        "true",
        "[[[]]]",
    )
    for key in (
        '"value": 1.0',
        '"std": 0.1',
        '"delay": 0.0',
        '"relative_error_percent": 3.0',
        '"decimation": 1',
        '"cutoff": 1.0',
    ):
        for number, value in enumerate(wrong):
            yield f"{key.split(chr(34))[1]} {number}.json", sound.replace(key, key.split(": ")[0] + f": {value}", 1)
    for number, value in enumerate(wrong):
        yield f"borders {number}.json", sound.replace("[0, 0]", f"[{value}, 0]")
        yield f"effects {number}.json", sound.replace('"effects": []', f'"effects": [{value}]')
        yield f"combinations {number}.json", sound.replace('"combinations": []', f'"combinations": [{value}]')
        yield f"all {number}.json", value
    for count in (1000, 300_000):
        for number, text in enumerate(
            ("[" * count, '{"a":' * count, "1" * count, '"' + "\\" * count, "-" * count, " " * count)
        ):
            yield f"text {number} of {count}.json", text


def _pages(_: Path) -> Iterator[tuple[str, str | bytes]]:
    for count in (1000, 100_000):
        for number, part in enumerate(
            (
                "<",
                "<a ",
                "<script ",
                "<!--",
                "<![",
                "&#",
                "<a b='",
                "</",
                "<?",
                "<script id='jointid'>",
                "<!DOCTYPE [",
                "<a b=c ",
                "&lt",
                "<svg><",
                "<![CDATA[",
            ),
        ):
            yield f"page {number} of {count}.html", "<" + part * count
