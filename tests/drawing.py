"""The share of the slowest layers that one run tests, drawn by the hash of a commit.

``JOINTID_DRAW=<any text>`` draws; without it every test runs. The same text draws the same tests and seeds. Random
attacks take their seed from it, too.
"""

from __future__ import annotations

import hashlib
import math
import os
import random
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import TypeVar

T = TypeVar("T")

DRAW = os.environ.get("JOINTID_DRAW", "")
"""What the draw is made from; empty if everything runs."""

SHARES = {"slow": 1 / 20, "browser": 1 / 4, "docs": 1 / 6, "hostile": 1 / 8}
"""The share of each layer that a draw keeps, rounded up and spread evenly over its files.

A slow test has relatives among the quick ones, which a page of the documentation has not. A test of several layers is
drawn in the last of them.
"""


def draw_tests(tests: Iterable[tuple[str, str]], draw: str) -> set[str]:
    """Return the identifiers of the tests that a draw keeps.

    The tests of a layer stand in one row, file after file, and the kept ones lie equally far apart in it.

    Args:
        tests: layer and identifier, as pytest writes it, of each test that may be left out.
        draw: text that the draw is made from.
    """
    layers = defaultdict(list)
    for layer, name in tests:
        layers[layer].append(name)
    kept: set[str] = set()
    for layer, names in layers.items():
        row = sorted(names, key=lambda name: (name.partition("::")[0], _hash(draw, name)))
        count = math.ceil(SHARES[layer] * len(row))
        first = random.Random(f"{draw} {layer}").random()
        kept.update(row[int((k + first) * len(row) / count)] for k in range(count))
    return kept


def _hash(draw: str, name: str) -> bytes:
    return hashlib.sha256(f"{draw} {name}".encode()).digest()


def draw_some(things: Sequence[T], layer: str) -> list[T]:
    """Return what a draw keeps of the parts of one test, in their order; all of them without a draw."""
    if not DRAW:
        return list(things)
    kept = random.Random(DRAW).sample(range(len(things)), math.ceil(SHARES[layer] * len(things)))
    return [things[k] for k in sorted(kept)]


def draw_seed(default: int) -> int:
    """Return the seed of a random attack: the default one, or that of the draw."""
    return random.Random(DRAW).randrange(10**9) if DRAW else default
