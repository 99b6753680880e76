"""Run studies, check a drawn part of them, or write their tables.

python -m studies [NAME ...]                 run all studies, or these, and store their shares in docs/studies.json
python -m studies NAME --seeds 1000:1200     run other seeds, and show their shares
python -m studies list                       show the studies
python -m studies check [NAME ...] [--draw WORD]
                                             judge a tenth of these again, or of a quarter of the studies; a word or
                                             else the commit draws them
python -m studies tables [--check]           write the tables of the documentation
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from jointid.common.text import align
from studies.comparing import LEVEL, compare, counted
from studies.registry import STUDIES
from studies.seeds import Judged, judge_tasks
from studies.stored import ROOT, Entry, Program, fill_tables, read_entries, shown_studies, write_entries
from studies.study import Study, draw_studies


def main(arguments: Sequence[str]) -> int:
    """Do what is asked for, and return the exit status."""
    command, given = _parse(arguments)
    names = given.names or [study.name for study in STUDIES]
    chosen = [study for study in STUDIES if study.name in names]
    if unknown := set(names) - {study.name for study in STUDIES}:
        _say(f'No study is called {", ".join(sorted(unknown))}; "python -m studies list" shows them.')
        return 2
    if command == "list":
        return _list()
    if command == "tables":
        return _write_tables(given.check)
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
    parser.add_argument("--check", action="store_true", help="of tables: fail where one is another, and write nothing")
    return command, parser.parse_args(arguments[command != "run" :])


def _seeds(text: str) -> range:
    first, _, after = text.partition(":")
    return range(int(first), int(after))


def _list() -> int:
    rows = [(study.name, str(len(study.tasks())), f"{len(study.shares)}", study.shows) for study in STUDIES]
    _say(align(("study", "tasks", "shares", "shows"), rows, (False, True, True, False)))
    return 0


def _run(chosen: Sequence[Study], seeds: range | None, out: Path | None) -> int:
    """Judge all tasks of the chosen studies; those of the registered seeds are stored."""
    program = Program.here()
    if out is None and program.clean:  # another program has other outcomes
        out = ROOT / "build" / "studies" / program.commit[:12]
    for study in chosen:
        judged = judge_tasks(study.tasks(seeds), out)
        entry = Entry(
            program, tuple(seeds or study.seeds), len(study.settings), sum(one.seconds for one in judged),
            study.count([one.outcome for one in judged]),
        )  # fmt: skip
        _show(study, entry)
        if seeds is None:
            write_entries(read_entries() | {study.name: entry})
    return 0


def _show(study: Study, entry: Entry) -> None:
    rows = []
    for label, letters in entry.shares.items():
        held, of = counted(letters)
        rows.append((label, f"{held}", f"{of}", f"{100 * held / max(of, 1):.1f}"))
    header = (study.name, "holds in", "of", "%")
    _say(f"{align(header, rows, (False, True, True, True))}\n{entry.seconds:.1f} s of the processor\n")


def _check(chosen: Sequence[Study], draw: str) -> int:
    """Judge a drawn tenth of each study again, and compare its shares with the stored ones."""
    stored = read_entries()
    if missing := [study.name for study in chosen if study.name not in stored or not stored[study.name].is_of(study)]:
        _say(f"docs/studies.json has other tasks or shares than {', '.join(missing)}; run them again.")
        return 1
    places = {study.name: study.draw(draw) for study in chosen}
    tasks = {study.name: [study.tasks()[place] for place in places[study.name]] for study in chosen}
    judged = iter(judge_tasks([task for study in chosen for task in tasks[study.name]]))
    failed, seconds = 0, 0.0
    for study in chosen:
        here: list[Judged] = [next(judged) for _ in places[study.name]]
        seconds += sum(one.seconds for one in here)
        found, was = study.count([one.outcome for one in here]), stored[study.name].shares
        compared = compare(study, was, places[study.name], found, len(STUDIES))
        _say(f"{study.name}: {len(here)} of {len(study.tasks())} tasks")
        for one in compared:
            drawn, others = (f"{held} of {of}" for held, of in (one.drawn, one.others))
            chances = f"p = {one.by_chance:.2g}; of the claim, p = {one.by_claim:.2g}"
            _say(f"  {one.label}: {drawn}; the others {others}; {chances}{'' if one.passed else '; FAILED'}")
            for place in one.changed:
                task = study.tasks()[place]
                _say(f"    another outcome than the stored one: seed {task.seed}, {dict(task.settings)}")
        failed += sum(not one.passed for one in compared)
    names = [study.name for study in chosen] if len(chosen) < len(STUDIES) else []
    _say(
        f"{seconds:.0f} s of the processor; drawn by {draw}; a right program fails in less than {LEVEL:g} of the runs\n"
        f"repeat: {' '.join(['python -m studies check', *names, '--draw', draw])}\n"
        f"{f'{failed} shares FAILED' if failed else 'all shares are as stored'}"
    )
    return int(failed > 0)


def _write_tables(check: bool) -> int:
    """Write the tables of all pages, or say which are not those of the stored outcomes."""
    stored, other = read_entries(), []
    for page in sorted((ROOT / "docs").rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        if shown_studies(text) and (filled := fill_tables(text, STUDIES, stored)) != text:
            other.append(page.relative_to(ROOT).as_posix())
            if not check:
                page.write_text(filled, encoding="utf-8")
    if other:
        _say(f"{', '.join(other)}: {'not the stored outcomes' if check else 'written'}")
    return int(check and bool(other))


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
