"""Results in a notebook: a sentence and a table, escaped; as data frames; and their pictures."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.controller_id.learned_controller import LearnedController
from jointid.controller_id.structures import Structure
from jointid.output.json import read_report
from tests.learned_once import find_law
from tests.output.report import reports


@cache
def results() -> dict[str, Any]:
    """Every kind of result that a notebook shows, of a record with a hostile name."""
    record, loop = reports.rigid_record(name=reports.EVIL)
    estimate = ji.identify(record, loop)
    return {"record": record, "estimate": estimate, "validation": ji.validate(estimate, record)}


@cache
def learned() -> LearnedController:
    """As if the search, which takes long, had found the law of the record."""
    record, _ = reports.rigid_record(name=reports.EVIL)
    with pytest.MonkeyPatch.context() as patch:
        find_law(patch, Structure(), {"position_gain": 40.0, "velocity_gain": 2.0})
        return ji.learn_controller(record)


@cache
def tuned() -> Any:
    return ji.tune(results()["estimate"])


def change(tmp_path: Any) -> Any:
    path = results()["estimate"].save(tmp_path / "a.json")
    return ji.compare(read_report(path), read_report(path))


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


@pytest.mark.parametrize("make", [pytest.param(learned, marks=pytest.mark.slow), tuned])
def test_a_notebook_shows_what_takes_longer_to_make(make: Callable[[], Any]) -> None:
    made = make()
    html = made._repr_html_()
    check(html, made.sentence)
    assert made.to_document().title == made.sentence
    assert "<table" in html
    assert len(made.to_dataframe()) > 0


def test_a_comparison_begins_with_whether_anything_changed(tmp_path: Any) -> None:
    made = change(tmp_path)
    check(made._repr_html_(), made.sentence)
    assert made.sentence == made.to_document().title
    assert made.sentence == "No difference can be tested, as both estimates share the errors of one record."
    assert made.to_dataframe().loc["inertia", "difference"] == 0.0


def test_the_report_shows_the_answer_and_the_parameters() -> None:
    html = reports.rigid()._repr_html_()
    check(html, str(reports.rigid().estimate.answer))
    assert "Inertia" in html.split("</p>")[0]
    assert len(repr(reports.rigid())) < 200


def test_a_record_is_a_data_frame_over_time() -> None:
    pytest.importorskip("pandas")
    record = results()["record"]
    frame = record.to_dataframe()
    assert tuple(frame.columns) == record.channels
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame["torque"], record.torque.values)
    slow = ji.Record(
        torque=ji.Channel(np.arange(4.0), "N", 1e-3), reference=ji.Channel(np.arange(2.0), "m", 2e-3), name="two rates"
    ).to_dataframe()
    assert np.isnan(slow["reference"]).tolist() == [False, True, False, True]


def test_a_validation_is_a_data_frame_over_time() -> None:
    pytest.importorskip("pandas")
    made = results()["validation"]
    frame = made.to_dataframe()
    np.testing.assert_array_equal(frame["error"], made.axes[0].measured - made.axes[0].predicted)
    assert frame.index[1] == made.sample_time


def test_without_pandas_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    for name in ("record", "validation"):
        with pytest.raises(ji.ExtraError):
            results()[name].to_dataframe()


def test_pictures_are_a_word_away() -> None:
    record, estimate, validation = results().values()
    assert [axes.get_ylabel() for axes in record.plot().axes] == [
        f"{name.replace('_', ' ')} [{channel.unit}]" for name, channel in record.items()
    ]
    assert record.plot().axes[-1].get_xlabel() == "time [s]"
    for figure in (estimate.plot(), validation.plot()):
        assert figure.axes[0].get_ylabel() == "torque [N m]"
