"""Run studies, check a drawn part of them, or print their table.

python -m studies [NAME ...]                 run all studies, or these, and store their shares in docs/studies.json
python -m studies NAME --seeds 1000:1200     run other seeds, and show their shares
python -m studies list                       show the studies
python -m studies check [NAME ...] [--draw WORD]
                                             judge a tenth of these again, or of a quarter of the studies; a word or
                                             else the commit draws them
python -m studies tables [--check]           print the table of the documentation, or check what is stored
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from jointid.common.document import Document, Table
from studies.registry import STUDIES
from studies.seeds import judge_tasks
from studies.stored import ROOT, Entry, Program, make_table, read_entries, write_entries
from studies.study import LEVEL, Study, counted, draw_studies, is_claimed


def main(arguments: Sequence[str]) -> int:
    """Do what is asked for, and return the exit status."""
    command, given = _parse(arguments)
    names = given.names or [study.name for study in STUDIES]
    chosen = [study for study in STUDIES if study.name in names]
    if unknown := set(names) - {study.name for study in STUDIES}:
        _say(f'No study is called {", ".join(sorted(unknown))}; "python -m studies list" shows them.')
        return 2
    if command == "list":
        rows = [(study.name, str(len(study.tasks())), study.shows) for study in STUDIES]
        _say(Document("", (Table(("study", "tasks", "shows"), tuple(rows), words=(0, 2)),)).text())
        return 0
    if command == "tables":
        return _check_stored() if given.check else _say(make_table(STUDIES, read_entries()))
    if command == "check":
        draw = given.draw or Program.here().commit
        return _check(chosen if given.names else draw_studies(STUDIES, draw), draw)
    return _run(chosen, given.seeds, given.out)


def _parse(arguments: Sequence[str]) -> tuple[str, argparse.Namespace]:
    command = arguments[0] if arguments and arguments[0] in ("list", "check", "tables") else "run"
    parser = argparse.ArgumentParser(
        prog="python -m studies", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help="of studies; all of them when none is given")
    parser.add_argument("--seeds", type=_seeds, metavar="A:B", help="others than the study's; nothing is stored")
    parser.add_argument("--out", type=Path, help="folder in which outcomes are kept, and found again")
    parser.add_argument("--draw", default="", metavar="WORD", help="of check: what draws the tasks")
    parser.add_argument("--check", action="store_true", help="of tables: fail where what is stored is of other studies")
    return command, parser.parse_args(arguments[command != "run" :])


def _seeds(text: str) -> range:
    return range(*map(int, text.split(":")))


def _run(chosen: Sequence[Study], seeds: range | None, out: Path | None) -> int:
    """Judge all tasks of the chosen studies; those of the registered seeds are stored."""
    program = Program.here()
    if out is None and program.clean:  # another program has other outcomes
        out = ROOT / "build" / "studies" / program.commit[:12]
    for study in chosen:
        judged = judge_tasks(study.tasks(seeds), out)
        shares = study.count([one.outcome for one in judged])
        seconds = sum(one.seconds for one in judged)
        rows = []
        for label, letters in shares.items():
            held, of = counted(letters)
            rows.append((label, f"{held}", f"{of}", f"{100 * held / max(of, 1):.1f}"))
        _say(Document("", (Table((study.name, "holds in", "of", "%"), tuple(rows)),)).text())
        _say(f"{seconds:.1f} s of the processor\n")
        if seeds is None:
            entry = Entry(program, tuple(study.seeds), len(study.settings), seconds, shares)
            write_entries(read_entries() | {study.name: entry})
    return 0


def _check(chosen: Sequence[Study], draw: str) -> int:
    """Judge a drawn tenth of each study again, and compare its shares with what is claimed of them."""
    if _check_stored():
        return 1
    stored = read_entries()
    places = {study.name: study.draw(draw) for study in chosen}
    tasks = {study.name: [study.tasks()[place] for place in places[study.name]] for study in chosen}
    judged = iter(judge_tasks([task for study in chosen for task in tasks[study.name]]))
    failed, seconds = 0, 0.0
    for study in chosen:
        here = [next(judged) for _ in places[study.name]]
        seconds += sum(one.seconds for one in here)
        found = study.count([one.outcome for one in here])
        _say(f"{study.name}: {len(here)} of {len(study.tasks())} tasks")
        for share in (one for one in study.shares if one.tested):
            letters, was = found[share.label], stored[study.name].shares[share.label]
            passed = is_claimed(study, share, letters, len(STUDIES))
            failed += not passed
            held, of = counted(letters)
            _say(f"  {share.label}: {held} of {of}{'' if passed else '; FAILED'}")
            for place, letter in zip(places[study.name], letters, strict=True):
                if was[place] != letter:
                    task = study.tasks()[place]
                    _say(f"    another outcome than the stored one: seed {task.seed}, {dict(task.settings)}")
    names = [study.name for study in chosen] if len(chosen) < len(STUDIES) else []
    _say(
        f"{seconds:.0f} s of the processor; drawn by {draw}; a right program fails in less than {LEVEL:g} of the runs\n"
        f"repeat: {' '.join(['python -m studies check', *names, '--draw', draw])}\n"
        f"{f'{failed} shares FAILED' if failed else 'all shares are as claimed'}"
    )
    return int(failed > 0)


def _check_stored() -> int:
    """Check that what is stored is of the studies that there are, and within their claims."""
    stored = read_entries()
    other = [study.name for study in STUDIES if study.name not in stored or not stored[study.name].is_of(study)]
    other += sorted(stored.keys() - {study.name for study in STUDIES})
    if other:
        _say(f"docs/studies.json has other tasks or shares than {', '.join(other)}; run them again.")
    beyond = [
        f"{study.name}: {share.label}"
        for study in STUDIES
        for share in study.shares
        if share.tested and study.name not in other
        and not is_claimed(study, share, stored[study.name].shares[share.label], len(STUDIES))
    ]  # fmt: skip
    if beyond:
        _say(f"beyond what is claimed: {', '.join(beyond)}")
    return int(bool(other or beyond))


def _say(text: str) -> int:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
