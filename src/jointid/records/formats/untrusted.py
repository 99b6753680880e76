"""Untrusted files: any error of a library becomes one sentence, and files that are too large are refused by size.

The libraries behind the binary formats raise whatever their parsers stumble over. None of it tells a user more than
that the file is damaged, so everything that comes out of them on the way from a file is that sentence.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jointid.common.errors import JointidError, RecordError

WHOLE = 2**32
"""Bytes of numbers that are read at once, 4 GiB: 50 columns of 10 million rows."""

PIECES = 2**40
"""Bytes of numbers that are read in chunks, 1 TiB: more than a year of 4 columns at 1 kHz."""

_NUMBER = 8  # bytes of a number in memory
_STEPS = ("KiB", "MiB", "GiB", "TiB", "PiB")


@contextmanager
def explain_damage(path: Path, format_name: str, remedy: str) -> Iterator[None]:
    """Turn whatever a library raises into the sentence on a file that is damaged.

    Args:
        path: the file.
        format_name: what it should be.
        remedy: what writes such a file, the end of the sentence.
    """
    try:
        yield
    except JointidError:
        raise
    except Exception as error:
        raise RecordError(
            f"{path.name} cannot be read as {format_name}: it is damaged, cut off or of another format; {remedy}."
        ) from error


def require_size(path: Path, numbers: int, limit: int = WHOLE) -> None:
    """Refuse a file that declares more numbers than are read, before there is memory for any of them.

    Raises:
        RecordError: the sentence has the size.
    """
    if numbers * _NUMBER > limit:
        advice = (
            "choose columns with jointid data convert --columns, or read it in chunks with jointid identify --window"
            if limit == WHOLE
            else "cut it into shorter files"
        )
        raise RecordError(
            f"{path.name} declares {format_size(numbers * _NUMBER)} of numbers, and at most {format_size(limit)} are "
            f"read; {advice}."
        )


def format_size(count: int) -> str:
    """Return a number of bytes in words."""
    if count < 1024:
        return f"{count} bytes"
    value, step = float(count), -1
    while value >= 1024 and step < len(_STEPS) - 1:
        value, step = value / 1024, step + 1
    return f"{value:.3g} {_STEPS[step]}" if value < 1000 else f"{value:.0f} {_STEPS[step]}"


def require_unique_names(path: Path, names: list[str]) -> None:
    """Refuse a file in which two columns have one name.

    Raises:
        RecordError: the sentence names it.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise RecordError(f"{path.name} has more than one column called {name!r}; rename them.")
        seen.add(name)
