"""A document as HTML. Every text is escaped on its way out; nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
from html import escape
from pathlib import PurePath

from jointid.common.document.blocks import (
    Block,
    Code,
    Document,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Verdicts,
)

_ANSWERS = {True: "Yes", False: "No", None: "Not known"}
_CLASSES = {True: "good", False: "bad", None: "open"}


def document_html(document: Document) -> str:
    """Return a document as a fragment of a page."""
    blocks = "\n".join(block_html(block) for block in document.blocks)
    return f'<div class="jointid">\n<p><strong>{escape(document.title)}</strong></p>\n{blocks}\n</div>'


def block_html(block: Block, anchor: str = "") -> str:
    """Return a block as HTML; `anchor` is what a heading is linked by."""
    if isinstance(block, Heading):
        link = f' id="{escape(anchor)}"' if anchor else ""
        return f"<h{block.level}{link}>{escape(block.text)}</h{block.level}>"
    if isinstance(block, Paragraph):
        return f"<p{' class=lead' if block.lead else ''}>{escape(block.text)}</p>"
    if isinstance(block, Listing | Verdicts | Facts):
        return "\n".join(_lines(block))
    if isinstance(block, Code):
        caption = f"<p>{escape(block.caption)}</p>\n" if block.caption else ""
        return f'{caption}<pre tabindex="0"><code>{escape(block.text)}</code></pre>'
    return _picture(block) if isinstance(block, Picture) else _table(block)


def inert(json: str) -> str:
    """Return JSON in which no tag, comment or entity of HTML can begin; it is the same JSON."""
    return json.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _lines(block: Listing | Verdicts | Facts) -> list[str]:
    if isinstance(block, Listing):
        return ["<ul>", *(f"<li>{escape(item)}</li>" for item in block.items), "</ul>"]
    if isinstance(block, Verdicts):
        return ['<ul class="verdicts">', *(_verdict(*row) for row in block.rows), "</ul>"]
    pairs = (f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in block.pairs)
    return ["<dl>", *pairs, "</dl>"]


def _verdict(asked: str, good: bool | None, reasons: tuple[str, ...]) -> str:
    why = "".join(f"\n<p>{escape(reason)}</p>" for reason in reasons)
    mark = f'<strong class="mark">{_ANSWERS[good]}</strong>'
    return f'<li class="{_CLASSES[good]}">{mark}<div><p class="asked">{escape(asked)}</p>{why}\n</div></li>'


def _picture(block: Picture) -> str:
    stem = escape(PurePath(block.name).stem)
    data = f'<script type="application/json" class="plot-data">{inert(block.plot)}</script>'
    plot = f'<div class="plot" id="plot-{stem}"></div>\n{data}\n' if block.plot else ""
    source = f"data:{block.kind};base64,{base64.b64encode(block.image).decode('ascii')}"
    image = f'<img class="still" src="{source}" alt="{escape(block.text)}">'
    narrow = "" if block.wide else " class=narrow"
    return f"<figure{narrow}>\n{plot}{image}\n<figcaption>{escape(block.text)}</figcaption>\n</figure>"


def _table(block: Table) -> str:
    kinds = [" class=text" if i in block.words else "" for i in range(len(block.header))]
    heads = "".join(f'<th scope="col"{k}>{escape(text)}</th>' for k, text in zip(kinds, block.header, strict=True))
    rows = [
        f'<tr><th scope="row">{escape(row[0])}</th>'
        + "".join(f"<td{k}>{escape(text)}</td>" for k, text in zip(kinds[1:], row[1:], strict=True))
        + "</tr>"
        for row in block.rows
    ]
    caption = [f"<caption>{escape(block.caption)}</caption>"] if block.caption else []
    label = escape(block.caption or "table")
    start = f'<div class="wide" tabindex="0" role="region" aria-label="{label}"><table>'
    head = [start, *caption, f"<thead><tr>{heads}</tr></thead>", "<tbody>"]
    return "\n".join([*head, *rows, "</tbody>", "</table></div>"])
