"""Studies: what is stored is within the claims, a spoiled program is caught; tasks whose outcome once was wrong."""

from dataclasses import replace

import numpy as np
import pytest

from studies import __main__ as command
from studies.robots import judge
from studies.seeds import Judged, Task
from studies.stiffness_bounds import identify_plant
from studies.stored import Entry, Program
from studies.study import Share, Study

SQUARES = Study("squares", "Squares.", "small", range(20), (Share("small", lambda outcome: outcome < 400, 0.9),))
SLOW = pytest.mark.slow


def test_what_is_stored_is_of_the_studies_and_within_their_claims(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["tables", "--check"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize(("judged", "code"), [("small", 0), ("large", 1)])
def test_a_check_fails_a_spoiled_program(judged: str, code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def judge_tasks(tasks: list[Task]) -> list[Judged]:
        return [Judged(task.seed**2 + 1000 * (task.function == "large"), 0.5) for task in tasks]

    program = Program("0123456789abcdef", True, "2026-11-25", "a processor, 2 cores")
    entry = Entry(program, tuple(SQUARES.seeds), 1, 12.2, SQUARES.count([seed**2 for seed in SQUARES.seeds]))
    monkeypatch.setattr(command, "STUDIES", (replace(SQUARES, judge=judged),))
    monkeypatch.setattr(command, "read_entries", lambda: {"squares": entry})
    monkeypatch.setattr(command, "judge_tasks", judge_tasks)
    assert command.main(["check", "--draw", "abc"]) == code


@pytest.mark.parametrize(
    ("seed", "refused"),
    [(2, False), *(pytest.param(seed, True, marks=SLOW) for seed in (5, 13, 57, 64, 89, 109, 716))],
)
def test_a_bound_of_a_refused_stiffness_is_true_and_a_plain_spring_is_given(seed: int, refused: bool) -> None:
    run = identify_plant(seed)
    assert run.refused is refused
    assert not run.violated
    assert run.simulations <= 1200
    assert run.value is None or (run.std and abs(run.value - run.stiffness) <= 4 * run.std)


@pytest.mark.parametrize(
    ("seed", "flexible"), [(6, False), *(pytest.param(seed, True, marks=SLOW) for seed in (11, 26, 72, 74, 80))]
)
def test_the_search_of_a_robot_ends_at_the_noise(seed: int, flexible: bool) -> None:
    found = judge(seed, flexible=flexible)
    assert found.at_noise
    assert np.mean(np.abs(found.z) < 2) > 0.85
