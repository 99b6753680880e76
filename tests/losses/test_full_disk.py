"""A disk that is full, at many sizes, for every writer: what was there stays, nothing is cut, a sentence says so."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest

from tests.losses.runs import COUNT, contents, require_calm, run_program

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
    "pictures": "report joint.toml -q --no-profiles --no-tuning --figures pages",
}
LONG = {
    "controller": "learn-controller joint.toml -q --write o.toml",
    "design": "design joint.toml -q --search-time 1 --out pages",
    "reproduce": "reproduce -q --out pages",
}
WRITERS |= LONG if COUNT >= 20 else {}


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
    slow = 4 if writer in LONG or "report" in words else 1
    for turn in range(max(SIZES // slow, 3)):
        most = max(sizes) * turn // max(SIZES // slow, 3)
        ended = run_program(*words, folder=place, most=most)
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
