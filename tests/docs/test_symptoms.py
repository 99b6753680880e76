"""The page of symptoms has every verdict, reason and fault that a command can print, in the words of the program."""

from __future__ import annotations

import re
from enum import StrEnum
from functools import cache

import pytest

from jointid.diagnostics import examine_record
from jointid.diagnostics.faults.fault import Fault
from jointid.diagnostics.faults.numbers import number_fault
from jointid.diagnostics.faults.registry import FAULTS
from jointid.diagnostics.law_comparison import FrictionShown, SpringShown
from jointid.diagnostics.validation import Prediction
from jointid.estimation.result.answer import Against, Found, Trust
from jointid.simulation.closed_loop import Outcome
from jointid.simulation.robots import RobotOutcome
from jointid.simulation.simulated import FINISHED
from jointid.uncertainty.verdict import Reason
from tests.docs.blocks import ROOT

GOOD = {
    Reason.SEARCH_ENDED, Reason.TORQUE_EXPLAINED, Reason.RESIDUAL_WHITE, Reason.NOTHING_REPEATS, Reason.ALL_DETERMINED,
    Reason.NO_PLACE_REVISITED, Reason.NONE_AT_BOUND, Reason.STIFFNESS_SHOWN, Reason.LOOP_AS_DECLARED,
    Trust.NOT_YET, Found.VALUE,
}  # fmt: skip
"""Codes that are no symptom, or of a line whose reason is the symptom."""
KINDS: tuple[type[StrEnum], ...] = (
    Trust, Found, Against, Reason, examine_record.Fault, Prediction, SpringShown, FrictionShown,
)  # fmt: skip
CODES = sorted({str(code) for kind in KINDS for code in kind if code not in GOOD} | {fault.name for fault in FAULTS})
ENDINGS = sorted({one.value for kind in (Outcome, RobotOutcome) for one in kind if one != FINISHED})


@cache
def rows() -> list[list[str]]:
    """Return the cells of each row of the page: what is printed with its codes, meaning, remedy."""
    text = (ROOT / "docs" / "symptoms.md").read_text(encoding="utf-8")
    split = [[cell.strip() for cell in line[1:-1].split("|")] for line in text.splitlines() if line[:3] == "| “"]
    return [cells for cells in split if len(cells) == 3]


@cache
def sentences() -> str:
    """Return the texts of the package, each in one line, and the names of its faults and their numbers."""
    texts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "src").rglob("*.py"))]
    joined = re.sub(r"([\"'])\s*\n\s*f?[\"']", "", "\n".join(texts)).replace('\\"', '"')
    numbers = ("position_gain", "velocity_gain", "derivative_gain", "integral_gain", "velocity_feedforward")
    phrases = [fault.phrase for fault in (*FAULTS, *map(number_fault, numbers))]
    return " ".join(f"{joined} {' '.join(phrases)}".split()).lower()


@pytest.mark.parametrize("code", CODES)
def test_every_code_has_an_entry_with_a_meaning_and_a_remedy(code: str) -> None:
    found = [cells for cells in rows() if f"`{code}`" in cells[0]]
    assert found, f"docs/symptoms.md has no entry for {code}"
    for _, meaning, remedy in found:
        assert len(meaning) > 10 < len(remedy)


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_end_of_a_simulation_has_an_entry(ending: str) -> None:
    begin = ending.split(",", maxsplit=1)[0]
    assert any(begin in cells[0] for cells in rows()), f"docs/symptoms.md has no entry for: {ending}"


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault.laws], ids=str)
def test_the_remedy_of_a_law_is_one_that_identifies_it(fault: Fault) -> None:
    (cells,) = (cells for cells in rows() if f"`{fault}`" in cells[0])
    laws = [f'{fault.table} = "{law}"' for law in fault.laws]
    assert any(law in cells[2] for law in laws) or "jointid diagnose springs" in cells[2]


def test_what_the_page_quotes_is_what_the_program_prints() -> None:
    quoted = [line for cells in rows() for line in re.findall("“([^”]+)”", cells[0])]
    assert len(quoted) >= len(rows())
    pieces = {piece.strip(" .,:;()%") for line in quoted for piece in re.split("…|: |; ", line.lower())}
    assert {piece for piece in pieces if piece not in sentences()} == set()
