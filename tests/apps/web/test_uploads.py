"""What comes in from a browser: bounded, named by us, read as numbers, shown escaped."""

from __future__ import annotations

import errno
import io
import os
import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointid.apps.web.application import build_application
from jointid.apps.web.folder import Limits, clean_name, read_json, write_json
from jointid.common.errors import RecordError
from tests.apps.web.asking import ADDRESS, TOKEN, Asker
from tests.apps.web.testclient import TestClient

HOSTILE = '../../<img src=x onerror=alert(1)>".csv'


@given(st.text(max_size=300))
def test_a_clean_name_is_one_name_of_harmless_characters(raw: str) -> None:
    name = clean_name(raw)
    assert name
    assert len(name) <= 80
    assert not set(name) & set("/\\<>:\"|?*&;'\n\r\t\0$`{}")
    assert not name.startswith(".")
    assert name not in (".", "..")
    assert clean_name(name) == name


def test_a_record_is_kept_under_a_harmless_name(asker: Asker, log: bytes, folder: Path) -> None:
    code, page = asker.send(HOSTILE, log)
    assert code == 200
    assert asker.folder.sent == ["_img src_x onerror_alert(1)__22.csv"]
    assert {path.name for path in folder.parent.iterdir()} == {"page"}
    assert {path.name for path in folder.iterdir()} == {"now"}
    assert '<option value="reference"' in page


def test_names_of_columns_are_escaped_everywhere(client: TestClient, asker: Asker) -> None:
    name = "<script>alert(1)</script>"
    rows = "\n".join(f"{i},{i * i}" for i in range(50))
    answer = client.post("/record", files={"file": ("a.csv", f"t,{name}\n{rows}".encode())})
    assert answer.status_code == 200
    assert name not in answer.text
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in answer.text
    asker.post("/draft", {"record.channels.torque.column": name, "extra": "</textarea><script>"})
    for path in ("/channels", "/joint", "/plot/1.svg"):
        assert "<script>alert" not in client.get(path).text
        assert "</textarea><script>" not in client.get(path).text


def test_a_file_that_is_too_large_is_stopped_at_the_bound(asker: Asker, limits: Limits) -> None:
    assert "larger than 2 MB" in asker.said("big.csv", b"1,2\n" * limits.upload)
    assert not asker.kept


def test_a_size_that_nobody_announced_is_stopped_at_the_bound(client: TestClient, asker: Asker, limits: Limits) -> None:
    sent = 0

    def body() -> Iterator[bytes]:
        nonlocal sent
        yield b'--x\r\nContent-Disposition: form-data; name="file"; filename="big.csv"\r\n\r\n'
        while sent < 10 * limits.upload:
            sent += 1000
            yield b"1,2\n" * 250

    answer = client.post("/record", content=body(), headers={"content-type": "multipart/form-data; boundary=x"})
    assert answer.status_code == 422
    assert "larger than 2 MB" in answer.text
    assert not asker.kept


@pytest.mark.parametrize("name", ["run.exe", "run.csv.html", "run", "run.pkl", "run.svg"])
def test_only_formats_that_are_read_are_taken(asker: Asker, log: bytes, name: str) -> None:
    assert ("has the suffix" if "." in name else "has no suffix") in asker.said(name, log)
    assert not asker.kept


def test_a_name_is_not_looked_for_on_this_machine(
    asker: Asker, log: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.run").mkdir()  # where it is looked for, a folder is a bag
    assert "there.run has the suffix" in asker.said("there.run", log)
    assert not asker.kept


class Boom:
    """An object that would run code when it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return exec, ("raise SystemExit('executed')",)


def test_nothing_in_a_file_is_executed(asker: Asker) -> None:
    objects = io.BytesIO()
    np.save(objects, np.array([Boom()], dtype=object), allow_pickle=True)
    assert "executed" not in asker.said("a.npy", objects.getvalue())
    assert "executed" not in asker.said("a.mat", pickle.dumps(Boom()))
    assert not asker.kept


@pytest.mark.parametrize(
    ("body", "kind", "said"),
    [
        (b"file=1", "application/x-www-form-urlencoded", "No file arrived"),
        (
            b'--x\r\nContent-Disposition: form-data; name="file"; filename=""\r\n\r\n\r\n--x--\r\n',
            "multipart/form-data; boundary=x",
            "No file arrived",
        ),
        (b"rubbish", "multipart/form-data; boundary=x", "did not arrive whole"),
        (b"", "multipart/form-data", "did not arrive whole"),
    ],
)
def test_damaged_forms_are_refused_in_a_sentence(client: TestClient, body: bytes, kind: str, said: str) -> None:
    answer = client.post("/record", content=body, headers={"content-type": kind})
    assert answer.status_code == 422
    assert said in answer.text


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_a_file_that_is_cut_off_leaves_nothing(client: TestClient, asker: Asker) -> None:
    body = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n1,2\n3,4\n'
    client.post("/record", content=body, headers={"content-type": "multipart/form-data; boundary=x"})
    assert not asker.kept


def test_a_text_file_can_be_read_in_another_way(asker: Asker) -> None:
    rows = "\n".join(f"{i},{5 * i % 7}" for i in range(100))  # decimal commas, or two columns?
    assert "decimal" in asker.said("a.csv", rows.encode())
    assert asker.folder.sent == ["a.csv"]
    assert asker.post("/again", {"record.delimiter": ",", "record.decimal": ".", "record.header": "false"})[0] == 200
    assert [column["name"] for column in asker.folder.preview["columns"]] == ["1", "2"]


def test_a_geared_axis_is_asked_for_its_gear_in_step_2_and_passes_it(asker: Asker) -> None:
    time = 1e-3 * np.arange(4000)
    command, torque = 30.0 * np.sin(3 * time) ** 3, np.sign(np.cos(3 * time)) + np.sin(7 * time)
    motor = 100.0 * 30.0 * np.sin(3 * (time - 0.03)) ** 3
    rows = "\n".join(",".join(map(repr, row)) for row in np.column_stack([time, torque, command, motor]).tolist())
    assert asker.send("axis.csv", f"t [s],torque [Nm],q_ref [deg],q_m [deg]\n{rows}\n".encode())[0] == 200
    channels = {"torque": "torque [Nm]", "reference": "q_ref [deg]", "motor_position": "q_m [deg]"}
    columns = {f"record.channels.{name}.column": column for name, column in channels.items()}
    status, said = asker.post("/channels", {"joint.kind": "revolute", **columns})
    assert status == 422
    assert "behind a gear of 100:1; give transmission.ratio = 100" in said
    geared = {"transmission.ratio": "100", "record.channels.reference.side": "load"}
    status, said = asker.post("/channels", geared)
    assert (status, "The record is sound" in said) == (200, True)
    assert 'href="/kept-secret/channels"' in said, "and back"


def test_a_joint_file_fills_in_the_form_and_is_named(asker: Asker, log: bytes) -> None:
    asker.send("log.csv", log)
    code, _ = asker.send(
        "my axis+1.toml", b'[controller]\nlaw = "cascade"\nposition_gain = 61.5\nvelocity_gain = 500.0\n'
    )
    assert code == 200
    assert 'value="61.5"' in asker.get("/joint")
    assert asker.folder.draft["controller.position_gain"] == "61.5"


def test_what_was_on_its_way_in_when_the_page_was_killed_is_removed(folder: Path, log: bytes) -> None:
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        Asker(client).send("log.csv", log)
    (folder / "upload-0123456789ab").mkdir()
    (folder / "now").rename(folder / "upload-0123456789ab" / "now")  # it was being replaced
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        assert Asker(client).folder.sent == ["log.csv"]
        assert {path.name for path in folder.iterdir()} == {"now"}


def test_a_full_disk_leaves_what_the_page_knew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, write = tmp_path / "draft.json", Path.write_bytes
    write_json(path, {"joint.kind": "revolute"})

    def half(self: Path, data: bytes) -> int:
        write(self, data[: len(data) // 2])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", half)
    with pytest.raises(RecordError, match=r"draft\.json cannot be written \(no space left on device\), and what"):
        write_json(path, {"joint.kind": "prismatic"})
    assert read_json(path) == {"joint.kind": "revolute"}
    assert list(tmp_path.iterdir()) == [path]
