"""A result as a document: blocks without a format, rendered as text, Markdown or HTML."""

from jointid.common.document.blocks import (
    Block,
    Code,
    Document,
    Documented,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Verdicts,
    common_facts,
)

__all__ = [
    "Block",
    "Code",
    "Document",
    "Documented",
    "Facts",
    "Heading",
    "Listing",
    "Paragraph",
    "Picture",
    "Table",
    "Verdicts",
    "common_facts",
]
