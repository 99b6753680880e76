"""Requests that mean no good: each is answered or cut off, none is a fault of ours, and the page goes on."""

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from urllib.parse import quote

import pytest

from tests.apps.web.asking import MULTIPART, TOKEN, Served, parts
from tests.drawing import draw_some
from tests.losses.runs import EXECUTED

pytestmark = pytest.mark.hostile

SECRET = "kept-out-of-sight"
FORM = "application/x-www-form-urlencoded"
HOST = "127.0.0.1"
SCRIPT = "<script>alert(1)</script>"
PATHS = (
    "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fsecret.txt", "/static/../worker.py",
    "/static/%2e%2e/%2e%2e/secret.txt", "/static//etc/passwd", "/static/page.js%00.html", "/static/" + "a" * 5000,
    "/runs/1/%2e%2e%2f%2e%2e%2fsecret.txt", "/runs/-1", "/runs/%00", "/runs/999999999", "/runs/0x1",
    "/runs/1/_run.json", "/runs/1/answer.json%00", "/plot/-1.svg", "/plot/999999999.svg", "/plot/..svg",
    "/joint?imported=" + quote(SCRIPT), "/" + "%2F" * 500, "/\\..\\..\\secret.txt", "//evil.example/",
    "/?" + "a=" * 2000,
    "/%E2%80%AE", "/draft/..%2f", "/channels/%0d%0aX: 1",
)  # fmt: skip
METHODS = (
    "PUT", "DELETE", "OPTIONS", "TRACE", "CONNECT", "get", "A" * 300, "G\x00T", "\u00e9".encode().decode("latin-1"),
)  # fmt: skip
HEADERS = (
    "content-length: -1", "content-length: 99999999999999999999", "content-length: 1e9",
    "content-length: 1\r\ncontent-length: 2", "transfer-encoding: gzip, chunked",
    "transfer-encoding: chunked\r\ncontent-length: 4", "range: bytes=0-" + "9" * 40, "range: bytes=" + "0-1," * 500,
    "if-none-match: " + "x" * 4000, "accept: \xff\xfe", "expect: 100-continue",
    "connection: upgrade\r\nupgrade: websocket", "cookie: " + "a=b; " * 900, "x-forwarded-host: evil.example",
    "origin: https://evil.example", "sec-fetch-site: cross-site", "content-type: multipart/form-data",
    "content-type: multipart/form-data; boundary=", "content-type: " + "a" * 5000, "x: " + "y" * 60000,
    "\r\n".join(f"x-{i}: y" for i in range(150)), "no colon", ": empty",
)  # fmt: skip
NAMES = (
    "../../secret.csv", "..\\..\\secret.csv", "/etc/passwd.csv", "a\x00b.csv", "a\r\nX-Injected: 1\r\n\r\n.csv",
    f"{SCRIPT}.csv", ".csv", "..", "CON.csv", "a" * 5000 + ".csv", "\u202egpj.csv", "a.csv/",
    f"$(touch {EXECUTED.name}).csv", f"`touch {EXECUTED.name}`.csv", "%2e%2e%2fx.csv", "_run.json", "\udcff.csv",
)  # fmt: skip
_FILE = b'--x\r\nContent-Disposition: form-data; name="file"; filename="%s"'
BODIES = (
    b"rubbish", b"--x", b"--x--\r\n", b"--x\r\n\r\n", b"--x\r\nContent-Disposition: form-data\r\n\r\n1\r\n--x--\r\n",
    _FILE % b"a.csv" + b"\r\n\r\n1,2\n",
    _FILE % b"a.csv" + b"\r\nContent-Type: " + b"a" * 9000 + b"\r\n\r\n1\r\n--x--\r\n",
    b'--x\r\nContent-Disposition: form-data; name="file"\r\n\r\n' + b"1" * 5000 + b"\r\n--x--\r\n",
    b"--x\r\n" + b"A: b\r\n" * 3000 + b"\r\n1\r\n--x--\r\n",
    b"".join(b'--x\r\nContent-Disposition: form-data; name="f%d"\r\n\r\n1\r\n' % i for i in range(2000)) + b"--x--\r\n",
    b"".join(_FILE % b"%d.csv" % i + b"\r\n\r\n1\r\n" for i in range(60)) + b"--x--\r\n",
)  # fmt: skip
ENTRIES = (
    "joint.kind=x", "joint.kind=%00", "controller.law=learn", "extra=%5Bjoint%5D%0Akind%3D%22%22",
    "extra=" + quote("[controller]\nlaw = []"), "extra=" + quote("a" + ".a" * 30000 + " = 1"),
    "extra=" + quote("[[" * 40000), "extra=" + "%ff" * 500, "__class__=1", "record.file=/etc/passwd", "=" * 5000,
    "&" * 50000, "controller.position_gain=" + "9" * 100000, "controller.position_gain=1e999", "record.delimiter=%00",
)  # fmt: skip


def request(method: str, path: str, *headers: str, body: bytes = b"", host: str = HOST, kind: str = "") -> bytes:
    head = [f"{method} {path} HTTP/1.1", f"host: {host}", "connection: close", *headers]
    if kind:
        head.append(f"content-type: {kind}")
    if body:
        head.append(f"content-length: {len(body)}")
    return "\r\n".join([*head, "", ""]).encode("latin-1", "replace") + body


def file_form(name: str, content: bytes) -> bytes:
    return parts(content, name.encode("utf-8", "surrogateescape").decode("latin-1"))


def attacks() -> Iterator[bytes]:
    """Yield requests, whole as they go over the wire."""
    root = f"/{TOKEN}"
    for path in PATHS:
        yield request("GET", root + path)
    for method in METHODS:
        yield request(method, f"{root}/record")
        yield request(method, "*")
    for header in HEADERS:
        yield request("POST", f"{root}/draft/joint", header)
        yield request("GET", f"{root}/static/page.js", header)
    for body, path in itertools.product(BODIES, ("/record", "/draft/joint", "/channels")):
        yield request("POST", root + path, body=body, kind=MULTIPART)
    for name in NAMES:
        yield request("POST", f"{root}/record", body=file_form(name, b"rubbish"), kind=MULTIPART)
    for suffix in (".mat", ".npy", ".npz", ".json", ".h5", ".parquet", ".mcap", ".tdms", ".db3"):
        yield request("POST", f"{root}/record", body=file_form(f"a{suffix}", b"\x00rubbish"), kind=MULTIPART)
    for entries, path in itertools.product(ENTRIES, ("/joint", "/draft/joint")):
        yield request("POST", root + path, body=entries.encode(), kind=FORM)
        if path == "/draft/joint":
            yield request("GET", f"{root}/channels")
            yield request("GET", f"{root}/joint")
    yield b"\x16\x03\x01\x02\x00" + b"\xff" * 200  # as a browser begins to encrypt
    yield b"GET /" + b"a" * 100000
    yield b"\x00" * 5000
    yield b"GET / HTTP/9.9\r\n\r\n"
    yield b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
    yield request("GET", f"{root}/", "transfer-encoding: chunked") + b"zz\r\n\r\n"
    yield request("POST", f"{root}/draft/joint", "transfer-encoding: chunked", kind=FORM) + b"fffffffffffffffff\r\na"
    yield request("GET", f"{root}/") * 50  # one behind the other


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_no_request_brings_the_page_down_or_has_it_tell_what_it_should_not(
    served: Served, folder: Path, log: bytes, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    (folder.parent / "secret.txt").write_text(SECRET)
    assert served.ask("POST", "/record", parts(log), MULTIPART)[0] == 303
    sent = list(attacks())
    assert len(sent) > 120
    sent = draw_some(sent, "hostile")
    with ThreadPoolExecutor(8) as attackers:
        answers = list(attackers.map(served.send, sent))
    for attack, answer in zip(sent, answers, strict=True):
        status = int(answer.split(b" ", 2)[1]) if answer.startswith(b"HTTP/1.1 ") else 0
        assert status != 500, (attack[:300], answer[-2000:])
        for told in (SECRET.encode(), b"root:x:", bytes(folder), b"Traceback", SCRIPT.encode(), b"\r\nX-Injected"):
            assert told not in answer, (attack[:300], told)
        if status == 403:
            assert TOKEN.encode() not in answer
    said = caplog.text + "".join(capfd.readouterr())
    assert all("LocalProtocolError" in one for one in said.split("Traceback")[1:]), "of requests that are no HTTP alone"
    assert {path.name for path in folder.parent.iterdir()} == {"page", "secret.txt"}
    assert not [*folder.rglob(EXECUTED.name), *Path().glob(EXECUTED.name)]
    assert served.ask("GET", "/")[0] == 200
    assert served.ask("POST", "/record", parts(log), MULTIPART)[0] == 303
    assert not [*folder.glob("upload-*")] and len([*folder.glob("now/*.csv")]) == 1
