"""Drawn outcomes beside the stored ones: a right program passes, a spoiled one is caught, the draw is what it says."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from studies.comparing import LEVEL, Counts, compare, compute_chance, compute_claim_chance, compute_level, counted
from studies.registry import STUDIES
from studies.stored import read_entries
from studies.study import FAILED, HELD, UNCOUNTED, Share, Study

SIMULATED = 5_000


def made(count: int, *shares: Share) -> Study:
    return Study("made", "A study.", "tests.studies.test_seeds:square", range(count), shares)


def is_failed(study: Study, share: Share, drawn: Counts, others: Counts) -> np.ndarray:
    """Return whether the check fails as it is run with all studies; each pair of counts is looked at once."""
    pairs, place = np.unique(np.stack([drawn[0], others[0]]), axis=1, return_inverse=True)
    each = (pairs[0], drawn[1]), (pairs[1], others[1])
    chances = np.minimum(compute_chance(*each, share), compute_claim_chance(*each, share))
    return np.asarray(chances < compute_level(study, len(STUDIES)))[place]


def shares_with_sizes() -> Iterator[tuple[Study, Share, int, int]]:
    for study in STUDIES:
        drawn, count = len(study.draw("a word")), len(study.tasks())
        yield from ((study, share, drawn, count - drawn) for share in study.shares if share.tested)


@pytest.mark.slow
def test_a_right_program_passes() -> None:
    """Every share is as bad as the documentation allows; stored and drawn outcomes are of that share."""
    rng, failed = np.random.default_rng(1), np.zeros(SIMULATED, dtype=bool)
    for study, share, drawn, others in shares_with_sizes():
        true = share.at_least or share.at_most
        counts = ((rng.binomial(of, true, SIMULATED), of) for of in (drawn, others))
        failed |= is_failed(study, share, *counts)
    assert np.mean(failed) < LEVEL


def test_a_program_that_makes_the_stored_outcomes_again_passes() -> None:
    rng, failed = np.random.default_rng(2), np.zeros(SIMULATED, dtype=bool)
    entries = read_entries()
    assert entries.keys() == {study.name for study in STUDIES}
    for study, share, drawn, _ in shares_with_sizes():
        letters = entries[study.name].shares[share.label] if study.name in entries else ""
        held, of = counted(letters)
        if of < len(letters) or not of:  # how many of the drawn tasks count differs from draw to draw
            continue
        found = rng.hypergeometric(held, of - held, drawn, SIMULATED)
        failed |= is_failed(study, share, (found, drawn), (held - found, of - drawn))
    assert np.mean(failed) < LEVEL


@pytest.mark.parametrize(
    ("count", "stored", "spoiled", "caught"),
    [(300, 0.97, 0.5, 0.95), (160, 0.97, 0.4, 0.9), (60, 1.0, 0.1, 0.8), (12, 1.0, 0.0, 1.0)],
)
def test_a_spoiled_program_is_caught(count: int, stored: float, spoiled: float, caught: float) -> None:
    """How surely, by how many tasks there are, and by how much rarer the property has become."""
    share, rng = Share("it holds", bool, 0.95), np.random.default_rng(3)
    study = made(count, share)
    drawn = len(study.draw("a word"))
    found = rng.binomial(drawn, spoiled, SIMULATED)
    others = np.full(SIMULATED, round(stored * (count - drawn)))
    assert np.mean(is_failed(study, share, (found, drawn), (others, count - drawn))) >= caught


@pytest.mark.parametrize("study", STUDIES, ids=lambda study: study.name)
def test_every_study_fails_if_all_that_is_drawn_is_wrong(study: Study) -> None:
    entry = read_entries()[study.name]
    for word in ("0123abc", "4567def", "89ab012"):
        places = study.draw(word)
        found = {
            share.label: "".join(
                letter if letter == UNCOUNTED else FAILED if share.at_least > 0.0 else HELD
                for letter in (entry.shares[share.label][place] for place in places)
            )
            for share in study.shares
        }
        assert not all(one.passed for one in compare(study, entry.shares, places, found, len(STUDIES))), word


def test_what_is_more_than_claimed_is_caught_where_that_is_bounded() -> None:
    share = Share("it holds", bool, at_most=0.1)
    study, places = made(100, share), range(0, 100, 10)
    stored, found = {share.label: HELD * 5 + FAILED * 95}, {share.label: HELD * 10}
    (said,) = compare(study, stored, places, found, 20)
    assert not said.passed
    assert said.changed == tuple(range(10, 100, 10))
    (said,) = compare(study, stored, places, {share.label: HELD + FAILED * 9}, 20)
    assert said.passed and not said.changed


def test_an_outcome_that_does_not_count_is_left_out() -> None:
    share = Share("it is even", lambda outcome: None if outcome == 3 else outcome % 2 == 0, 0.5)
    letters = made(4, share).count([0, 1, 2, 3, None])[share.label]
    assert letters == "101--"
    assert counted(letters) == (2, 3)


def test_a_draw_is_that_of_its_word() -> None:
    study = made(200, Share("it holds", bool, 0.5))
    drawn = study.draw("0123abc")
    assert drawn == study.draw("0123abc") == sorted(set(drawn))
    assert len(drawn) == 20
    assert drawn != study.draw("0123abd")
    assert len(made(12).draw("0123abc")) == 8
    assert len(made(3).draw("0123abc")) == 3
    often = np.bincount([place for word in range(2000) for place in study.draw(str(word))], minlength=200)
    assert often.min() > 150 and often.max() < 250  # 200 of each are meant


def test_studies_are_what_they_say() -> None:
    assert len({study.name for study in STUDIES}) == len(STUDIES)
    for study in STUDIES:
        assert len({share.label for share in study.shares}) == len(study.shares)
        assert list(study.seeds) == list(range(study.seeds[0], study.seeds[0] + len(study.seeds)))
        for share in study.shares:
            assert 0 <= share.at_least < share.at_most <= 1
            assert share.at_least > 0 or share.at_most < 1, f"{study.name}: {share.label} claims nothing"
