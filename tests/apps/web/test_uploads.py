"""What comes in from a browser: bounded, named by us, read as numbers, shown escaped."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from jointid.apps.web import folder as bounds
from jointid.apps.web.form import clean_name
from jointid.apps.web.routes import build_application
from tests.apps.web.asking import ADDRESS, TOKEN, Asker, TestClient

HOSTILE = '../../<img src=x onerror=alert(1)>".csv'


@given(st.text(max_size=300))
@example("../Answer.JSON")
def test_a_clean_name_is_one_name_of_harmless_characters(raw: str) -> None:
    name = clean_name(raw)
    assert 0 < len(name) <= 80
    assert not set(name) & set("/\\<>:\"|?*&;'\n\r\t\0$`{}")
    assert not name.startswith((".", "_"))
    assert name.lower() not in (".", "..", "answer.json", "report.html")
    assert clean_name(name) == name


def test_a_record_is_kept_under_a_harmless_name(asker: Asker, log: bytes, folder: Path) -> None:
    code, page = asker.send(HOSTILE, log)
    assert code == 200
    assert asker.page.now.records == ["img src_x onerror_alert(1)__22.csv"]
    assert {path.name for path in folder.parent.iterdir()} == {"page"}
    assert {path.name for path in folder.iterdir()} == {"now"}
    assert "<option>reference</option>" in page


def test_names_of_columns_are_escaped_everywhere(client: TestClient, asker: Asker) -> None:
    name = "<script>alert(1)</script>"
    rows = "\n".join(f"{i},{i * i}" for i in range(50))
    answer = client.post("/record", files={"file": ("a.csv", f"t,{name}\n{rows}".encode())})
    assert answer.status_code == 200
    assert name not in answer.text and "&lt;script&gt;alert(1)&lt;/script&gt;" in answer.text
    asker.post("/draft/joint", {"record.channels.torque.column": name, "joint.name": "</textarea><script>"})
    for path in ("/channels", "/joint", "/plot/1.svg"):
        assert "<script>alert" not in client.get(path).text
        assert "</textarea><script>" not in client.get(path).text


def test_a_size_that_nobody_announced_is_stopped_at_the_bound(client: TestClient, asker: Asker) -> None:
    sent = 0

    def body() -> Iterator[bytes]:
        nonlocal sent
        yield b'--x\r\nContent-Disposition: form-data; name="file"; filename="big.csv"\r\n\r\n'
        while sent < 10 * bounds.UPLOAD:
            sent += 1000
            yield b"1,2\n" * 250

    answer = client.post("/record", content=body(), headers={"content-type": "multipart/form-data; boundary=x"})
    assert answer.status_code == 200 and "larger than 1.91 MB" in answer.text
    assert not asker.kept


@pytest.mark.parametrize("name", ["run.exe", "run.csv.html", "run", "run.pkl", "run.svg", "there.run"])
def test_only_formats_that_are_read_are_taken(asker: Asker, log: bytes, name: str) -> None:
    assert "no format that is read" in asker.said(name, log)
    assert not asker.kept


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # Starlette leaves its spool open
def test_a_file_that_is_cut_off_leaves_nothing(client: TestClient, asker: Asker) -> None:
    body = b'--x\r\nContent-Disposition: form-data; name="file"; filename="a.csv"\r\n\r\n1,2\n3,4\n'
    client.post("/record", content=body, headers={"content-type": "multipart/form-data; boundary=x"})
    assert not asker.kept


@pytest.mark.slow
def test_a_text_file_can_be_read_in_another_way(client: TestClient, asker: Asker) -> None:
    rows = "\n".join(f"{i},{5 * i % 7}" for i in range(100)).encode()  # decimal commas, or two columns?
    assert "decimal" in asker.said("a.csv", rows)
    options = {"record.delimiter": ",", "record.decimal": ".", "record.header": "false"}
    assert client.post("/record", files={"file": ("a.csv", rows)}, data=options).status_code == 200
    assert asker.page.now.texts["record.header"] == "false"
    assert [column["name"] for column in asker.page.now.json("_columns.json")["columns"]] == ["1", "2"]


def test_units_are_asked_where_nothing_says_them(asker: Asker) -> None:
    rows = "\n".join(f"{0.001 * i},{i % 7},{i * i}" for i in range(50))
    asker.send("a.csv", f"t,force,way [mm]\n{rows}\n".encode())
    columns = {"record.channels.torque.column": "force", "record.channels.reference.column": "way [mm]"}
    page = asker.post("/draft/channels", {"joint.kind": "prismatic", "transmission.ratio": "7,0", **columns})[1]
    assert "2401 mm of the load, or 2401 mm of the motor: then 343 mm of the load" in page  # the side is asked for
    assert re.findall(r'<select id="record-channels-(torque|reference)-unit"[^>]* required>', page) == ["torque"]


@pytest.mark.slow
def test_a_joint_file_fills_in_the_form(client: TestClient, asker: Asker, log: bytes) -> None:
    joint = b'[controller]\nlaw = "cascade"\nposition_gain = 61.5\nvelocity_gain = 500.0\n'
    files = [("file", ("log.csv", log)), ("file", ("my axis+1.toml", joint))]
    assert client.post("/record", files=files).status_code == 200
    assert 'value="61.5"' in asker.get("/joint")
    assert asker.page.now.records == ["log.csv"]


def test_what_was_on_its_way_in_when_the_page_was_killed_is_removed(folder: Path) -> None:
    (folder / "upload-0123456789ab").mkdir()
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS):
        assert not [*folder.iterdir()]


@pytest.mark.parametrize("content", ["", "{}", "7", "[" * 100_000, '{"state": 1}', "record = 3", "\xff"])
def test_a_folder_that_is_damaged_is_shown(folder: Path, content: str) -> None:
    for path in (
        *(folder / "runs" / "1" / one for one in ("_run.json", "answer.json")),
        *(folder / "now" / f"{one}" for one in ("_texts.json", "_checked.json", "_columns.json")),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="latin-1")
    with TestClient(build_application(folder, TOKEN), base_url=ADDRESS) as client:
        for address in ("/", "/channels", "/joint", "/runs/1"):
            assert client.get(address).status_code == 200, address


def test_a_link_out_of_the_folder_is_not_followed(folder: Path, client: TestClient) -> None:
    run = folder / "runs" / "1"
    run.mkdir(parents=True)
    (folder.parent / "secret.txt").write_text("kept out of sight")
    (run / "answer.json").symlink_to(folder.parent / "secret.txt")
    assert client.get("/runs/1/answer.json").status_code == 404
