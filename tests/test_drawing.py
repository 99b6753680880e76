"""What a draw leaves out: a share of each layer, the same for the same text, and every test at some time."""

from __future__ import annotations

import pytest

from tests import drawing
from tests.drawing import SHARES, draw_seed, draw_some, draw_tests

TESTS = [("docs", f"tests/docs/test_{file}.py::test_{k}") for file in "abc" for k in range(12)]
TESTS += [("hostile", "tests/test_one.py::test_a")]


def test_a_layer_keeps_its_share_spread_over_its_files() -> None:
    for draw in ("a", "b", "c"):
        kept = draw_tests(TESTS, draw)
        assert kept == draw_tests(TESTS[::-1], draw)
        for file in "abc":
            assert sum(f"test_{file}.py" in name for name in kept) == 12 * SHARES["docs"]
        assert "tests/test_one.py::test_a" in kept
    assert draw_tests(TESTS, "a") != draw_tests(TESTS, "b")


def test_every_test_is_drawn_at_some_time() -> None:
    assert set().union(*(draw_tests(TESTS, str(k)) for k in range(80))) == {name for _, name in TESTS}


def test_the_parts_of_a_test_are_drawn_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "DRAW", "")
    assert draw_some(range(10), "hostile") == list(range(10))
    monkeypatch.setattr(drawing, "DRAW", "a")
    some = draw_some(range(10), "hostile")
    assert some == sorted(set(some)) and len(some) == 2


def test_a_seed_is_that_of_the_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "DRAW", "")
    assert draw_seed(3) == 3
    monkeypatch.setattr(drawing, "DRAW", "a")
    first = draw_seed(3)
    monkeypatch.setattr(drawing, "DRAW", "b")
    assert first != draw_seed(3) != 3
