"""One document, three renderings; what comes in as text stays text in each of them."""

from __future__ import annotations

import io
from html.parser import HTMLParser

from jointid.common.document import (
    Code,
    Document,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Verdicts,
    block_html,
    plain_console,
)

EVIL = '<script>alert("1")</script>\x1b[31m[red](javascript:x)'
EVERY = Document(
    "a title",
    (
        Facts((("read", "torque"),)),
        Table(("symbol", "value"), (("ZZ", "94.9"), ("offset", "-3")), "the table"),
        Heading("checks"),
        Verdicts(
            (
                ("fit", True, ("4 % remains",)),
                ("whiteness", False, ("one", "two")),
                ("loop", None, ("-",)),
            )
        ),
        Paragraph("a paragraph"),
        Listing(("first", "second")),
        Code("x = 1", "a program"),
        Picture("p.svg", lambda: b"<svg/>", "a picture"),
    ),
)
HOSTILE = Document(
    EVIL,
    (
        Facts(((EVIL, EVIL),)),
        Table((EVIL, EVIL), ((EVIL, EVIL),), EVIL),
        Heading(EVIL),
        Verdicts(((EVIL, False, (EVIL,)),)),
        Paragraph(EVIL),
        Listing((EVIL,)),
        Code(EVIL, EVIL),
        Picture("p.svg", lambda: b"", EVIL),
    ),
)


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append(tag)


def test_html_makes_no_tag_of_a_text() -> None:
    hostile, every = ("".join(map(block_html, document.blocks)) for document in (HOSTILE, EVERY))
    assert "script" not in Tags(hostile).found
    assert Tags(hostile).found.count("table") == Tags(every).found.count("table") == 1


def test_a_terminal_gets_colour_and_obeys_no_name() -> None:
    def printed(document: Document) -> str:
        out = io.StringIO()
        document.print(plain_console(file=out, force_terminal=True, width=100, color_system="standard"))
        return out.getvalue()

    said = printed(EVERY)
    assert "\x1b[1;31mno" in said
    assert "94.9" in said
    assert "\x1b[31m[red]" not in printed(HOSTILE)
    assert "\\x1b[31m" in printed(HOSTILE)
