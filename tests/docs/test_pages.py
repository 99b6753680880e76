"""The pages that are written from the program say what it says."""

from __future__ import annotations

import doctest
import inspect
import re
import sys
from collections.abc import Callable
from importlib import import_module
from operator import attrgetter
from typing import Any

import pytest

import jointid
from jointid.config import json_schema
from jointid.diagnostics.faults.registry import FAULTS
from tests.docs.blocks import ROOT, blocks, pages

sys.path.insert(0, str(ROOT / "docs" / "_ext"))

import commands
import curves
import diagrams
import joint_file_keys
import pages as generated
import search_words


def test_the_commands_page_has_the_commands_own_tables() -> None:
    page = commands.PAGE.read_text(encoding="utf-8")
    assert commands.written(page) == page, "write it again: python docs/_ext/commands.py"


@pytest.mark.parametrize("name", commands.names())
def test_every_command_and_option_has_a_meaning(name: str) -> None:
    for row in commands.table(name).splitlines()[2:]:
        option, values, default, meaning = (cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1])
        assert option
        assert values
        assert default
        assert len(meaning) > 10, row


def test_the_page_of_keys_has_every_key_of_the_schema_with_its_meaning() -> None:
    page = joint_file_keys.page()
    rows = dict(re.findall(r"^\| `([^`]+)` \| (.*) \|$", page, re.MULTILINE))
    for table in json_schema()["properties"]:
        assert re.search(rf"^## `\[+{table}\]+`$", page, re.MULTILINE), table
    for key, cells in {
        "joint.kind": ('`"prismatic"`, `"revolute"`', "—", "required", "how the joint moves: m and N, or rad and N m"),
        "record.clock_tolerance": ("number, 0 or more", "—", "`0.05`", "largest jitter of the time stamps"),
        "filtering.cutoff": (
            "positive number or text with a unit", "Hz", "—", "cut-off of the decimation filter on torque and columns",
        ),
        "filtering.borders": (
            "list of whole numbers, 0 or more", "—", "`[50, 50]`", "samples dropped at the start and at the end",
        ),
        "parameters.<name>.lower": ("number", "—", "—", "lower bound"),
        "records.file": ("text", "—", "required", "path of the record, from the joint file's folder"),
    }.items():  # fmt: skip
        assert rows[key].startswith(" | ".join(cells)), key
    assert rows["controller.integral_gain"].startswith(
        'number, 0 or more or text with a unit | `"cascade"`: 1/s; `"pid"`: controller units per m s'
    )
    assert rows["controller.velocity_limit"].endswith('(of `"cascade"`)')
    for key in (
        "record.channels.<channel>.unit",
        "record.channels.torque.tap",
        "controller.torque_filters.depth",
        "controller.B.position",
        "gravity.counterbalance.cos",
    ):
        assert key in rows
    assert all(len(cells.split(" | ")[-1]) > 8 for cells in rows.values())


@pytest.mark.parametrize(("name", "draw"), diagrams.DIAGRAMS.items())
def test_a_diagram_is_drawn_by_its_program_and_names_keys_of_the_controller(name: str, draw: Callable[[], Any]) -> None:
    drawing = draw()
    saved = (diagrams.IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    assert drawing.svg() == saved, "write it again: python docs/_ext/diagrams.py"
    assert set(drawing.keys) <= set(re.findall(r"`controller\.(\w+)`", joint_file_keys.page()))
    assert f"images/{name}.svg" in (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(("name", "draw"), curves.CURVES.items())
def test_a_curve_is_drawn_by_its_program(name: str, draw: Callable[[], Any]) -> None:
    numbers, saved = re.compile(r"\d+(?:\.\d+)?"), (curves.IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    drawn = draw().svg()
    assert numbers.sub("", drawn) == numbers.sub("", saved), "write it again: python docs/_ext/curves.py"
    now, before = ([float(one) for one in numbers.findall(text)] for text in (drawn, saved))
    assert now == pytest.approx(before, abs=0.3)
    assert f"images/{name}.svg" in (ROOT / "docs" / "how-well-it-works.md").read_text(encoding="utf-8")


def test_every_public_name_has_an_entry_and_a_docstring() -> None:
    entries = "".join(text for name, text in generated.written().items() if name.startswith("api-"))
    modules = {name: module for name in jointid.__all__ if inspect.ismodule(module := getattr(jointid, name))}
    spaces = {name: module for name, module in modules.items() if module.__name__ == f"jointid.{name}"}
    assert spaces.keys() == {"controller", "friction", "robots", "spring"}
    public = {f"{space}.{name}" for space, module in spaces.items() for name in module.__all__}
    public |= {*jointid.__all__} - modules.keys()
    names = rf"\w+|(?:{'|'.join(spaces)})\.\w+"
    found = re.findall(rf"^\.\. auto\w+:: jointid\.({names})$", entries, re.MULTILINE)
    assert set(found) == public
    assert all(f".. automodule:: {modules[name].__name__}\n" in entries for name in modules.keys() - spaces.keys())
    for name in public:
        assert inspect.getdoc(attrgetter(name)(jointid)), name


def test_every_public_name_has_an_example_that_runs() -> None:
    """In a program of the documentation, or in the docstrings, whose examples the next test runs."""
    programs = [block.text for page in pages() for block in blocks(page) if block.runs and block.language != "sh"]
    for path in SOURCE.rglob("*.py"):
        examples = re.findall(r"^ *(?:>>>|\.\.\.) ?(.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
        programs.append("\n".join(examples))
    shown = set()
    for program in programs:
        shown.update(re.findall(r"\b(?:ji|jointid)\.((?:\w+\.)?\w+)", program))
        for line in re.findall(r"^ *from jointid[\w.]* import (.+)$", program, re.MULTILINE):
            shown.update(re.findall(r"\w+", line))
    missing = [name for name in generated.HOMES if not {name, name.rpartition(".")[2]} & (shown | _heads(shown))]
    assert not missing, "add it to docs/reference/examples.md"


def _heads(names: set[str]) -> set[str]:
    """Return the first words of dotted names: `Estimate` of `Estimate.load`."""
    return {name.partition(".")[0] for name in names}


SOURCE = ROOT / "src"
WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCE.rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


@pytest.mark.docs
@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_of_the_docstrings_hold(module: str) -> None:
    found = doctest.testmod(import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    assert found.failed == 0
    assert found.attempted > 0


def test_links_of_a_page_that_moves_lead_where_they_did() -> None:
    here, there = ROOT / "examples" / "emps", ROOT / "docs" / "reference" / "generated"
    text = "[a](../../docs/timing.md#x) [b](https://x.org/y.md) [c](#z) [d](../../README.md) [e](..)"
    assert (
        generated.relinked(text, here, there)
        == "[a](../../timing.md#x) [b](https://x.org/y.md) [c](#z) [d](readme.md) e"
    )


def test_the_table_of_faults_has_every_fault() -> None:
    text = (ROOT / "docs" / "faults.md").read_text(encoding="utf-8")
    section = text.partition("\n\nA wrong drive gain")[0]
    named = re.findall(r"`(\w+)`", " ".join(row.split("|")[1] for row in re.findall(r"^\|.*", section, re.MULTILINE)))
    assert {one.name for one in FAULTS} - set(named) == set()
    assert section.count("\n\n|") == 1, "the table is in pieces"


def test_every_page_of_the_documentation_is_in_the_navigation() -> None:
    lists = "\n".join(page.read_text(encoding="utf-8") for page in pages() if page.is_relative_to(ROOT / "docs"))
    listed = {
        re.sub(r"^.*<|>$", "", line.strip()).rsplit("/", 1)[-1].rstrip("*")
        for block in re.findall(r"```\{toctree\}\n(.*?)```", lists, re.DOTALL)
        for line in block.splitlines()
    }
    for page in (ROOT / "docs").rglob("*.md"):
        if "generated" not in page.parts and page != ROOT / "docs" / "index.md":
            assert page.stem in listed, f"{page.name} is in no toctree"


@pytest.mark.parametrize(("word", "ours"), search_words.WORDS.items())
def test_the_glossary_has_a_word_of_the_drives_beside_ours(word: str, ours: str) -> None:
    assert any(ours in row for row in search_words.rows(word)), f"{word!r} beside {ours!r}"


@pytest.mark.parametrize(
    "word",
    [
        "backlash",
        "resonance",
        "antiresonance",
        "notch",
        "Tn",
        "Kv",
        "Kp",
        "following error",
        "wrong sign",
        "sample time",
    ],
)
def test_a_heading_has_what_is_searched_for_most(word: str) -> None:
    headings = [line for page in pages() for line in page.read_text(encoding="utf-8").splitlines() if line[:2] == "##"]
    assert any(re.search(rf"\b{word}\b", heading, re.IGNORECASE) for heading in headings)
