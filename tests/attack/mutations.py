"""Mutations of a file: what goes wrong on its way, and what somebody does to it who knows its format; by a seed."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence

_TOKENS = (
    b"\0",
    b"\xff\xfe",
    b'"',
    b"'",
    b"\n",
    b"\r",
    b"\t",
    b",",
    b";",
    b".",
    b"1e400",
    b"-1e400",
    b"nan",
    b"inf",
    b"\x1b[2J",
    b"EOF",
    b"[",
    b"]",
    b"{",
    b"}",
    b"#",
    b'"""',
    b"null",
    b"true",
    b"-",
    b"1e-300",
    b"9" * 400,
    b"a." * 300,
    b"\\u0000",
    b"</script>",
    b"<!--",
    "\u202e".encode(),
    b"\xed\xa0\x80",
    b"__proto__",
    b"=1+1",
)
_NUMBERS = (0, 1, -1, 2**31 - 1, -(2**31), 2**32 - 1, 2**62, -(2**63), 2**63 - 1, 0x7F, 0xFF, 0xFFFF, 10**9)
_BEGINNING = 2000  # bytes, where most formats describe themselves


def mutate(content: bytes, others: Sequence[bytes], chance: random.Random) -> bytes:
    """Return a file with one to six mutations; `others` are files of which parts are taken."""
    made = bytearray(content)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        chance.choice(_KINDS)(made, others, chance)
        if not made:
            made += b"\0"
    return bytes(made[: 2 * len(content) + 10_000])


def _place(made: bytearray, chance: random.Random) -> int:
    """Return a place: anywhere, or more often where a format describes itself, at the beginning and the end."""
    kind = chance.randrange(4)
    if kind == 0:
        return chance.randrange(min(len(made), _BEGINNING))
    if kind == 1:
        return len(made) - 1 - chance.randrange(min(len(made), _BEGINNING))
    return chance.randrange(len(made))


def _turn_bits(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    for _number in range(chance.choice((1, 1, 2, 8, 64))):
        made[_place(made, chance)] ^= 1 << chance.randrange(8)


def _set_bytes(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    at = _place(made, chance)
    made[at : at + chance.choice((1, 4, 16))] = bytes([chance.randrange(256)]) * chance.choice((1, 4, 16))


def _set_number(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    """Put an extreme number where a length or an offset may be."""
    kind = chance.choice(("<i", ">i", "<q", ">q", "<h", "<d", "<f"))
    number = chance.choice(_NUMBERS)
    bits = 8 * struct.calcsize(kind)
    if kind[1] in "df":
        packed = struct.pack(kind, chance.choice((float("inf"), float("nan"), 1e300 if kind[1] == "d" else 1e38, -0.0)))
    else:
        packed = (number % 2**bits).to_bytes(bits // 8, "little" if kind[0] == "<" else "big")
    at = _place(made, chance)
    made[at : at + len(packed)] = packed


def _cut_off(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    del made[_place(made, chance) :]


def _cut_out(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    at = _place(made, chance)
    del made[at : at + chance.choice((1, 2, 7, 64, 1000))]


def _put_in(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    at = _place(made, chance)
    made[at:at] = chance.choice(_TOKENS) * chance.choice((1, 1, 1, 3, 50))


def _repeat(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    at = _place(made, chance)
    part = made[at : at + chance.choice((1, 8, 100, 2000))]
    made[at:at] = part * chance.choice((1, 2, 10))


def _exchange(made: bytearray, _: Sequence[bytes], chance: random.Random) -> None:
    one, other, size = _place(made, chance), _place(made, chance), chance.choice((1, 8, 64, 512))
    made[one : one + size], made[other : other + size] = made[other : other + size], made[one : one + size]


def _graft(made: bytearray, others: Sequence[bytes], chance: random.Random) -> None:
    other = chance.choice(others)
    begin, at = chance.randrange(len(other)), _place(made, chance)
    part = other[begin : begin + chance.choice((16, 200, 4000))]
    made[at : at + (len(part) if chance.random() < 0.5 else 0)] = part


_KINDS: tuple[Callable[[bytearray, Sequence[bytes], random.Random], None], ...] = (
    _turn_bits,
    _turn_bits,
    _set_bytes,
    _set_number,
    _set_number,
    _cut_off,
    _cut_out,
    _put_in,
    _put_in,
    _repeat,
    _exchange,
    _graft,
)
