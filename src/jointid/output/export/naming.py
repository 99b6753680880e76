"""Names and remarks as another language can hold them: whoever named a record must not write its program."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection

_LONGEST = 48  # of the 63 characters that MATLAB reads of a name: what is put before and behind it stays readable
_REMARK = 300  # characters of somebody's text that a remark keeps


def one_line(text: str) -> str:
    """Return a text as one line that can be printed: whatever breaks or steers a line becomes a space.

    Unicode has line ends beside ``\\n``, marks that turn the direction of reading, and halves of characters, which no
    file can hold; all are of its categories C and Z.
    """
    shown = "".join(" " if unicodedata.category(char)[0] in "CZ" else char for char in text)
    words = " ".join(shown.split())
    return words if len(words) <= _REMARK else f"{words[:_REMARK]}..."


def identifier(text: str, reserved: Collection[str] = ()) -> str:
    """Return a name made of a text: a letter, then letters, digits and _ of ASCII; "joint" where nothing is left.

    Args:
        text: of any kind.
        reserved: words of the language, in lower case, that are no names.
    """
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode("ascii")
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:_LONGEST].strip("_") or "joint"
    if not name[0].isalpha() or name.lower() in reserved:
        name = f"joint_{name}"
    return name


def xml_comment(text: str) -> str:
    """Return a line as an XML comment can hold it: without two hyphens in a row, or one at its end."""
    return re.sub(r"-(?=-)", "- ", one_line(text)).removesuffix("-").rstrip()


def number(value: float) -> str:
    """Return a number with all its digits, as every one of the languages reads it."""
    return repr(float(value) + 0.0)  # of 0 there is no negative
