"""The person at the page without a browser: sends what its forms send."""

import contextlib
import http.client
import re
import socket
import time
import warnings
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from typing import Any

from jointid.apps.web.folder import Draft
from jointid.apps.web.routes import Page

with warnings.catch_warnings():  # it would rather have the successor of httpx
    warnings.simplefilter("ignore")
    from starlette.testclient import TestClient

TOKEN = "kept-secret"
ADDRESS = f"http://127.0.0.1:8765/{TOKEN}/"
LAW = {"joint.model": "rigid", "controller.law": "cascade", "controller.position_gain": "60"}
LAW["controller.velocity_gain"] = "500"
UNITS = {
    "joint.kind": "prismatic",
    **{f"record.channels.{name}.column": name for name in ("torque", "reference", "motor_position")},
    "record.channels.torque.unit": "N",
    "record.channels.reference.unit": "m",
    "record.channels.motor_position.unit": "m",
}


def code_of(answer: Any) -> int:
    """The status of an answer, 422 of a page with a fault."""
    return 422 if 'role="alert"' in answer.text or "aria-invalid" in answer.text else int(answer.status_code)


@dataclass
class Asker:
    """The person who started the page."""

    client: TestClient

    def get(self, path: str) -> str:
        answer = self.client.get(path)
        assert answer.status_code == 200, answer.text
        return unescape(answer.text)

    def post(self, path: str, data: dict[str, str] | None = None) -> tuple[int, str]:
        answer = self.client.post(path, data=data or {})
        return code_of(answer), unescape(answer.text)

    def send(self, name: str, content: bytes, to: str = "/record") -> tuple[int, str]:
        answer = self.client.post(to, files={"file": (name, content)})
        return code_of(answer), unescape(answer.text)

    def said(self, name: str, content: bytes) -> str:
        """Send a record that is refused, and return why."""
        code, text = self.send(name, content)
        assert (code, "fault of ours" in text) == (422, False)
        (faults,) = re.findall(r'<div class="faults".*?</div>', text, re.DOTALL)
        return str(faults)

    def identify(self, log: bytes, **fields: str) -> Draft:
        """Go through the steps, and return the identification."""
        assert 'name="record.time"' in self.send("log.csv", log)[1]  # in step 2
        assert self.post("/channels", UNITS)[0] == 200
        answer = self.client.post("/joint", data={**LAW, **fields}, follow_redirects=False)
        assert answer.status_code == 303, answer.text
        return Draft(self.page.path / "runs" / answer.headers["location"].rsplit("/", 1)[1])

    @property
    def page(self) -> Page:
        found = self.client.app.state.page
        assert isinstance(found, Page)
        return found

    @property
    def kept(self) -> set[str]:
        """The names of all files in the folder."""
        folder: Path = self.page.path
        return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}

    def ended(self, run: Draft, most: float = 400.0) -> str:
        """Wait for the end of an identification, and return its state."""
        for _ in range(int(most / 0.1)):
            if (state := str(self.page.jobs.state(run)["state"])) != "running":
                return state
            time.sleep(0.1)
        raise AssertionError(f"still running after {most} s: {run.read('_progress.txt')}")


WAIT = 300.0  # seconds that a machine which is busy may take


class Served:
    """A page that is served in this process."""

    def __init__(self, port: int) -> None:
        self.port = port

    def connect(self) -> socket.socket:
        return socket.create_connection(("127.0.0.1", self.port), timeout=WAIT)

    def ask(self, method: str, path: str, body: bytes = b"", kind: str = "") -> tuple[int, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=WAIT)
        try:
            connection.request(method, f"/{TOKEN}{path}", body, {"content-type": kind} if kind else {})
            answer = connection.getresponse()
            return answer.status, answer.read()
        finally:
            connection.close()

    def send(self, raw: bytes) -> bytes:
        """Send bytes as they are and no more, and return all that comes back; half a request is answered by nothing."""
        got = b""
        with self.connect() as made, contextlib.suppress(ConnectionError, TimeoutError):  # cut off, which is an answer
            made.settimeout(5.0)
            made.sendall(raw)
            while part := made.recv(65536):
                got += part
        return got

    def begin_upload(self, declared: int, sent: bytes = b"1,2\n") -> socket.socket:
        """Send the beginning of a file of a declared size, and no more."""
        head = f"POST /{TOKEN}/record HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-length: {declared}\r\n"
        made = self.connect()
        made.sendall(
            head.encode() + b"content-type: multipart/form-data; boundary=x\r\n\r\n--x\r\n"
            b'Content-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n' + sent
        )
        return made


def parts(content: bytes, name: str = "log.csv") -> bytes:
    """Return a form with a file."""
    head = f'--x\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n\r\n'
    return head.encode() + content + b"\r\n--x--\r\n"


MULTIPART = "multipart/form-data; boundary=x"
