"""A part of `python -m tests.attack`: files of every kind, mutated and made by hand, are read or refused."""

from __future__ import annotations

import json
import random
from pathlib import Path

import pytest

from jointid.common.errors import RecordError
from tests.attack.__main__ import attack, mutated
from tests.attack.attacking import READERS, Tally
from tests.attack.by_hand import make_hostile
from tests.attack.mutations import mutate
from tests.attack.samples import ANSWER, make_samples
from tests.drawing import DRAW, SHARES, draw_seed

MUTATED, EVERY = 700, 12
FEWER = round(1 / SHARES["hostile"]) if DRAW else 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("attack")
    (folder / "sound").mkdir()
    return folder


@pytest.mark.hostile
@pytest.mark.filterwarnings("ignore")  # what libraries say of a damaged file on the side
def test_mutated_files_are_read_or_refused(folder: Path) -> None:
    tally, seed, count = Tally(), draw_seed(3), MUTATED // FEWER
    print(f"seed {seed}")
    assert attack(mutated(make_samples(folder / "sound"), count, seed), folder, tally) == count
    assert tally.failures == []
    assert tally.outcomes["read"] > count / 10 and tally.outcomes["refused"] > count / 2


@pytest.mark.hostile
@pytest.mark.filterwarnings("ignore")
def test_files_made_by_hand_are_read_or_refused(folder: Path) -> None:
    tally, every = Tally(), EVERY * FEWER
    part = draw_seed(0) % every
    print(f"part {part}")
    assert attack(make_hostile(folder / "sound"), folder, tally, every=every, part=part) >= 300 // every
    assert tally.failures == []


@pytest.mark.parametrize("number", ["1e400", "-1e400"])
def test_an_answer_with_a_number_without_end_is_refused(number: str, tmp_path: Path) -> None:
    path = tmp_path / "answer.json"
    path.write_text(json.dumps(ANSWER).replace("[0, 0]", f"[{number}, 0]"), encoding="utf-8")
    for read in READERS["answer"]:
        with pytest.raises(RecordError, match=r"answer\.json"):
            read(path)


def test_sound_files_are_read_and_a_seed_makes_the_same_mutations(folder: Path, tmp_path: Path) -> None:
    samples, tally = make_samples(tmp_path), Tally()
    assert len(samples) == 21
    attack(iter(samples), folder, tally)
    assert tally.failures == [] and tally.outcomes["read"] >= 45
    again = [[one.content for one in mutated(samples, 60, seed)] for seed in (5, 5, 6)]
    assert again[0] == again[1] != again[2]
    assert mutate(b"\0", [b"\0"], random.Random(0))
