"""A disk that is full, at many sizes, for every writer: what was there stays, nothing is cut, a sentence says so."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from jointid.common.document import Document, Paragraph, Picture
from jointid.config import JointFile
from tests.losses.runs import COUNT, contents, note, require_calm, run_program
from tests.losses.test_outputs import learned_in_no_time, reproduced_in_no_time

pytestmark = [pytest.mark.hostile, pytest.mark.skipif(sys.platform != "linux", reason="bounds on files")]

OLD = b"what was there"
SIZES = max(COUNT // 4, 3)
WRITERS = {
    **{
        suffix: f"data convert table.csv o{suffix}"
        for suffix in (".csv", ".mat", ".npy", ".npz", ".json", ".h5", ".parquet", ".tdms")
    },
    ".mat 7.3": "data convert table.csv o.mat --mat-version 7.3",
    ".mcap": "data convert table.csv o.mcap",
    ".db3": "data convert table.csv o.db3",
    "bag": "data convert table.csv bag",
    "answer": "compare estimate.json estimate.json --json o.json",
    **{f"figure {suffix}": f"data inspect table.csv --figure o{suffix}" for suffix in (".png", ".svg", ".pdf")},
    **{
        f"export {suffix}": f"export joint.toml --estimate estimate.json --out o{suffix}"
        for suffix in (".toml", ".json", ".m", ".xml", ".mo")
    },
    "page": "report joint.toml -q --no-profiles --no-tuning --html o.html",
    "pages": "report joint.toml -q --no-profiles --no-tuning --markdown pages",
    "controller": "learn-controller joint.toml -q --write o.toml",
    "design": "design joint.toml -q --estimate estimate.json --noise-log 5 --search-time 0.2 --out pages",
    "reproduction": "reproduce -q --out pages",
    "pictures": "report joint.toml -q --no-profiles --no-tuning --figures pages",
}


@pytest.fixture(autouse=True)
def no_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes minutes is made up: a learned controller and a reproduction."""
    page = Document(
        "Tables",
        (Paragraph("of the paper, " * 200), Picture("torque.png", lambda: bytes(20_000), "a torque", "torque")),
    )
    monkeypatch.setattr(JointFile, "learn_controller", lambda file, *_: learned_in_no_time(file))
    monkeypatch.setattr("jointid.paper.reproduce.reproduce", lambda *_: reproduced_in_no_time())
    monkeypatch.setattr("jointid.paper.reproduce.report_reproduction", lambda *_: page)


@pytest.mark.parametrize("writer", WRITERS)
def test_the_old_result_stays_and_the_new_one_is_not_cut(writer: str, place: Path) -> None:
    words = WRITERS[writer].split()
    done = run_program(*words, folder=place)
    assert done.code == 0, done
    made = contents(place)
    target = next(word for word in words if word.startswith(("o.", "bag", "pages")))
    if (place / target).is_dir():
        sizes = [len(made[name]) for name in made if name.startswith(f"{target}/")]
        shutil.rmtree(place / target)
    else:
        sizes = [len(made[target])]
        (place / target).write_bytes(OLD)
    before = contents(place)
    count = max(SIZES // 4, 3) if "report" in words else SIZES
    for turn in range(count):
        most = max(sizes) * turn // count
        ended = run_program(*words, folder=place, most=most)
        note(seconds=ended.seconds - done.seconds)
        require_calm(ended, (2,))
        assert "cannot be written" in ended.said, ended
        assert contents(place) == before, (writer, most)
        assert not list(place.glob(".jointid-*"))


def test_an_array_that_lacks_its_last_bytes_is_not_taken_for_whole(place: Path) -> None:
    """C keeps the end of a short file to itself until it is closed, and NumPy does not ask how that went."""
    words = WRITERS[".npy"].split()
    assert run_program(*words, folder=place).code == 0
    (place / "o.npy").rename(place / "whole.npy")
    ended = run_program(*words, folder=place, most=(place / "whole.npy").stat().st_size - 1)
    require_calm(ended, (2,))
    assert "cannot be written" in ended.said, ended
    assert not (place / "o.npy").exists()
