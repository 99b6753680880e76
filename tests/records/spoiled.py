"""Files that went wrong on their way: cut off, with bits turned, emptied, or under another format's name."""

from __future__ import annotations

import random
from collections.abc import Iterator, Sequence
from pathlib import Path

_BEGINNING = 1200  # bytes, where most formats describe themselves
_END = 600  # bytes, where the others do


def spoiled(path: Path, folder: Path, suffixes: Sequence[str], *, cuts: int = 8, flips: int = 24) -> Iterator[Path]:
    """Yield copies of a file, each spoiled in one way; the same ones every time.

    Args:
        path: the file.
        folder: where each copy is made; the next one replaces it.
        suffixes: of other formats, under which it is also stored whole.
        cuts: how many are cut off somewhere.
        flips: how many have some of their bits turned, half of them where the file describes itself.
    """
    whole, chance = path.read_bytes(), random.Random(path.suffix)
    copy = folder / f"spoiled{path.suffix}"
    for content in (b"", b"\0" * 100, whole[: len(whole) // 2] * 2):
        copy.write_bytes(content)
        yield copy
    for number in range(cuts):
        copy.write_bytes(whole[: 1 + number * (len(whole) - 2) // max(cuts - 1, 1)])
        yield copy
    for number in range(flips):
        content = bytearray(whole)
        for _ in range(chance.choice([1, 1, 2, 8])):
            content[_place(len(whole), number, chance)] ^= 1 << chance.randrange(8)
        copy.write_bytes(content)
        yield copy
    for suffix in suffixes:
        other = folder / f"renamed{suffix}"
        other.write_bytes(whole)
        yield other


def _place(size: int, number: int, chance: random.Random) -> int:
    if number % 4 == 0:
        return chance.randrange(min(size, _BEGINNING))
    if number % 4 == 1:
        return size - 1 - chance.randrange(min(size, _END))
    return chance.randrange(size)
