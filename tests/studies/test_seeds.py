"""Seeds as a campaign: every result in the order of its seed, and made once."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from studies.seeds import judge_seeds


@dataclass(frozen=True)
class Squared:
    """A number of a study."""

    seed: int
    value: float


def square(seed: int, log: str, scale: float) -> Squared | None:
    with Path(log).open("a", encoding="utf-8") as file:
        file.write(f"{seed}\n")
    return None if seed == 3 else Squared(seed, scale * seed**2)


def test_results_are_those_of_the_seeds_and_are_made_once(tmp_path: Path) -> None:
    log, out = tmp_path / "log", tmp_path / "out"
    asked = "tests.studies.test_seeds:square", {"log": str(log), "scale": 0.5}
    first = list(judge_seeds(asked[0], range(4), asked[1], out=out))
    assert first == [{"seed": n, "value": 0.5 * n**2} for n in range(3)]
    more = list(judge_seeds(asked[0], range(1, 6), asked[1], out=out))
    assert [one["seed"] for one in more] == [1, 2, 4, 5]
    assert sorted(log.read_text().split()) == ["0", "1", "2", "3", "4", "5"]
