"""Names that come from outside: kept to be shown, never used as paths on this machine."""

from __future__ import annotations

import re
import unicodedata

_LONGEST = 80  # characters
_OTHER = re.compile(r"[^\w .()+-]")
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def safe_name(raw: str, otherwise: str) -> str:
    """Return what is left of a file's name when folders, control characters and whatever has a meaning are taken out.

    The suffix is kept. The name is fit for a download, an entry of an archive and a joint file, on any system.

    Args:
        raw: as the browser sent it.
        otherwise: the name where nothing is left.
    """
    name = unicodedata.normalize("NFC", re.split(r"[/\\]", raw)[-1])
    name = _OTHER.sub("_", name).strip(" .")
    stem, dot, suffix = name.rpartition(".")
    if len(name) > _LONGEST:
        name = f"{stem[: _LONGEST - len(suffix) - 1]}{dot}{suffix}" if len(suffix) < _LONGEST // 2 else name[:_LONGEST]
    return f"_{name}" if _DEVICES.match(name) else name or otherwise
