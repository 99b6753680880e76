"""One document, three renderings; what comes in as text stays text in each of them, and in a notebook."""

import io
from functools import cache
from typing import Any

import pytest

import jointid as ji
from jointid.common.document import Document, Facts, Picture, Table, Text, plain_console, templates
from tests.output.report import reports

EVIL = '<script>alert("1")</script>\x1b[31m[red](javascript:x)'


def every(text: str) -> Document:
    """A document with every kind of block, of one text."""
    return Document(
        text,
        (
            Facts(((text, text),)),
            Table((text, text), ((text, text),), text),
            Text(text, "heading"),
            Facts(((text, text), (text, f"{text}\n{text}"), (text, text)), (True, False, None)),
            Text(text),
            Text("\n".join((text, text)), "list"),
            Text(text, "code"),
            Picture("p.svg", lambda: b"<svg/>", text),
        ),
    )


def test_html_makes_no_tag_of_a_text() -> None:
    hostile, friendly = (
        reports.Elements("".join(map(templates().get_template("blocks.html").module.show, every(text).blocks)))
        for text in (EVIL, "a text")
    )
    assert hostile.tags == friendly.tags and "table" in hostile.tags and not hostile.open


def test_a_terminal_gets_colour_and_obeys_no_name() -> None:
    def printed(text: str) -> str:
        out = io.StringIO()
        every(text).print(plain_console(file=out, force_terminal=True, width=100, color_system="standard"))
        return out.getvalue()

    assert "\x1b[1;31mno" in printed("a text")
    assert "\x1b[31m[red]" not in printed(EVIL)
    assert "\\x1b[31m" in printed(EVIL)


@cache
def results() -> dict[str, Any]:
    """Every kind of result that a notebook shows, of a record with a hostile name."""
    record, loop = reports.rigid_record(name=reports.EVIL)
    estimate = ji.identify(record, loop)
    return {"record": record, "estimate": estimate, "validation": ji.validate(estimate, record)}


@pytest.mark.parametrize("name", ["estimate", "validation"])
def test_a_notebook_shows_a_sentence_and_a_table(name: str) -> None:
    made = results()[name]
    html = made._repr_html_()
    found = reports.Elements(html)
    assert not found.open and not {"script", "a"} & {*found.tags}
    assert html.index("<p>") < html.index("<table") if "<table" in html else True
    assert html.count(f"<p>{made.sentence.split('<')[0][:30]}") == 1  # a title that is the answer is not said again


def test_pictures_are_a_word_away() -> None:
    _, estimate, validation = results().values()
    for figure in (estimate.plot(), ji.figures.torque(validation)):
        assert figure.axes[0].get_ylabel() == "torque [N m]"
