"""Results in a notebook: a sentence and a table, escaped; as data frames; and their pictures."""

from __future__ import annotations

import sys
from functools import cache
from html.parser import HTMLParser
from typing import Any

import pytest

import jointid as ji
from tests.output.report import reports


@cache
def results() -> dict[str, Any]:
    """Every kind of result that a notebook shows, of a record with a hostile name."""
    record, loop = reports.rigid_record(name=reports.EVIL)
    estimate = ji.identify(record, loop)
    return {"record": record, "estimate": estimate, "validation": ji.validate(estimate, record)}


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: object) -> None:
        del attrs
        self.seen.append(tag)
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def check(html: str, sentence: str) -> None:
    """It has a table, begins with the sentence, and its tags are closed; no name makes one."""
    found = Tags(html)
    assert found.open == []
    assert "script" not in found.seen
    assert "a" not in found.seen
    assert sentence
    assert html.index("<p>") < html.index("<table") if "<table" in html else True


@pytest.mark.parametrize("name", ["record", "estimate", "validation"])
def test_a_notebook_shows_a_sentence_and_a_table(name: str) -> None:
    made = results()[name]
    html = made._repr_html_()
    check(html, made.sentence)
    words = made.sentence.split("<")[0][:30]
    assert html.count(f"<p>{words}") == 1  # a title that is the answer is not said again


def test_without_pandas_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ji.ExtraError):
        results()["estimate"].to_dataframe()


def test_pictures_are_a_word_away() -> None:
    record, estimate, validation = results().values()
    assert [axes.get_ylabel() for axes in record.plot().axes] == [
        f"{name.replace('_', ' ')} [{channel.unit}]" for name, channel in record.items()
    ]
    assert record.plot().axes[-1].get_xlabel() == "time [s]"
    for figure in (estimate.plot(), validation.plot()):
        assert figure.axes[0].get_ylabel() == "torque [N m]"
