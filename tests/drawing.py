"""The share of the slowest layers that one run tests, drawn by the hash of a commit.

``JOINTID_DRAW=<any text>`` draws; without it every test runs. The same text draws the same tests and seeds. Random
attacks take their seed from it, too.
"""

import math
import os
import random
from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")

DRAW = os.environ.get("JOINTID_DRAW", "")
"""What the draw is made from; empty if everything runs."""

SHARES = {"slow": 1 / 20, "browser": 1 / 4, "docs": 1 / 6, "hostile": 1 / 8}
"""The share of each layer that a draw keeps. A slow test has relatives among the quick ones, which a page has not."""


def is_drawn(layer: str, name: str) -> bool:
    """Return whether a draw keeps a test of a layer, by its identifier."""
    return not DRAW or random.Random(f"{DRAW} {name}").random() < SHARES[layer]


def draw_some(things: Sequence[T], layer: str) -> list[T]:
    """Return what a draw keeps of the parts of one test, in their order; all of them without a draw."""
    if not DRAW:
        return list(things)
    kept = random.Random(DRAW).sample(range(len(things)), math.ceil(SHARES[layer] * len(things)))
    return [things[k] for k in sorted(kept)]


def draw_seed(default: int) -> int:
    """Return the seed of a random attack: the default one, or that of the draw."""
    return random.Random(DRAW).randrange(10**9) if DRAW else default
