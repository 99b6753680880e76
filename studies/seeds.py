"""The seeds of a study as a campaign: on all cores, each result kept as it comes, so that a study may be ended."""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jointid.campaigns.cases import Case, Simulated, canonical
from jointid.campaigns.engines import LocalProcesses
from jointid.campaigns.folder import read_results
from jointid.campaigns.rows import Outcome, Row
from jointid.campaigns.run import run_cases
from jointid.campaigns.store import open_database


def judge_seeds(
    function: str, seeds: Iterable[int], *settings: Mapping[str, Any], out: Path | None = None
) -> Iterator[Any]:
    """Yield what a function of a seed gives, for each seed in its order, as JSON has it; nothing where it gives None.

    Args:
        function: of a seed and the settings, which returns a dataclass, numbers or None, as "studies.mechanics:judge".
        seeds: each a case of the campaign, with each of the settings.
        settings: the function's other arguments, as JSON has them; of several all seeds of the first come first.
        out: folder in which results are kept, and found again; one for this call alone when None.
    """
    asked = itertools.product(map(canonical, settings), list(seeds))
    cases = [Case(function, "", "", "", changes=(one,), varied=Simulated((), seed=n)) for one, n in asked]
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory())) if out is None else out
        folder.mkdir(parents=True, exist_ok=True)
        with open_database(folder) as database:
            run_cases(lambda: cases, LocalProcesses(), database, name=function, carry=_carry, progress=_say)
        rows = {row.content_hash: row for row in read_results(folder).rows}
    for case in cases:
        found = json.loads(rows[case.content_hash].sentence)
        if found is not None:
            yield found


def _carry(case: Case) -> Row:
    """Return what the function of a case gives, as JSON in the place of a row's sentence."""
    module, _, name = case.joint.partition(":")
    assert isinstance(case.varied, Simulated)
    found = getattr(import_module(module), name)(case.varied.seed, **json.loads(case.changes[0]))
    said = asdict(found) if is_dataclass(found) and not isinstance(found, type) else found
    return Row.of(case, Outcome.IDENTIFIED, json.dumps(said, sort_keys=True))  # a margin may be infinite


def parse_seeds(about: str | None, count: int, *more: str) -> argparse.Namespace:
    """Return what a study is asked for: `seeds`, a range of so many unless told, `out`, and flags by their names."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("seeds", nargs="*", type=int, metavar="FIRST AFTER_LAST")
    parser.add_argument("--out", type=Path, help="folder in which results are kept, and found when it is given again")
    for flag in more:
        parser.add_argument(f"--{flag}", action="store_true")
    given = parser.parse_args()
    if len(given.seeds) not in (0, 2):
        parser.error("expected two numbers, the first seed and the one after the last")
    given.seeds = range(*(given.seeds or (0, count)))
    return given


def _say(said: str) -> None:
    sys.stderr.write(f"{said}\n")
