"""What comes in from a browser: bounded, named by us, read as numbers, shown escaped."""

from __future__ import annotations

import io
import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jointid.apps.web.folder import Limits, name_in_run
from jointid.apps.web.requests import clean_name
from tests.apps.web.asking import Asker
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


@pytest.mark.parametrize(
    ("raw", "name"),
    [
        ("run 1.csv", "run 1.csv"),
        ("../../etc/passwd", "passwd"),
        ("C:\\logs\\Achse-3 (neu).CSV", "Achse-3 (neu).CSV"),
        ("", "record"),
        ("...", "record"),
        ("é" * 200 + ".mat", "é" * 76 + ".mat"),
    ],
)
def test_what_is_left_of_a_name(raw: str, name: str) -> None:
    assert clean_name(raw) == name


def test_a_record_is_kept_under_our_name_and_shown_under_its_own(asker: Asker, log: bytes, folder: Path) -> None:
    code, page = asker.send(HOSTILE, log)
    assert code == 200
    assert asker.kept == {
        "record.csv",
        "record.json",
        "preview.json",
        "draft.json",
        "work.json",
        "log.txt",
        "progress.txt",
    }
    assert asker.folder.record["name"] == "_img src_x onerror_alert(1)__22.csv"
    assert {path.name for path in folder.parent.iterdir()} == {"page"}
    assert '<option value="reference" selected' in page
    assert asker.folder.draft["record.channels.torque.column"] == "torque"


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("Achse-3 (neu).CSV", "Achse-3 (neu).CSV"),
        ("Answer.txt", "record.txt"),  # which the answer itself is called
        ("\N{MATHEMATICAL BOLD SMALL A}" * 76 + ".mat", "record.mat"),  # 308 bytes
    ],
)
def test_the_folder_of_a_run_has_the_record_under_its_own_name_where_it_can(name: str, kept: str) -> None:
    assert name_in_run(clean_name(name)) == kept


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
    assert "record.npy" not in asker.kept
    assert "record.mat" not in asker.kept


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
    assert asker.folder.record is not None
    assert asker.post("/again", {"record.delimiter": ",", "record.decimal": ".", "record.header": "false"})[0] == 200
    assert [column["name"] for column in asker.folder.preview["columns"]] == ["1", "2"]


def test_a_joint_file_fills_in_the_form_and_is_named(asker: Asker, log: bytes) -> None:
    asker.send("log.csv", log)
    code, text = asker.send("my axis+1.toml", b'[controller]\nlaw = "cascade"\nkp = 61.5\nkv = 500.0\n', "/jointfile")
    assert code == 200
    assert "Filled in from my axis+1.toml" in text
    assert asker.folder.draft["controller.kp"] == "61.5"
