"""`python -m tools.licences write` or `check`: the table of dependencies and their licences in the documentation.

The packages are those of requirements.txt, with all extras, on every platform; the licences are what each package says
of itself where it is installed.
"""

from __future__ import annotations

import re
import sys
from importlib.metadata import PackageNotFoundError, metadata, requires
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
PINNED = ROOT / "requirements.txt"
EXTRAS = ("logs", "report", "web", "models", "dataframe", "cluster", "slurm", "remote", "robots")

# Packages whose metadata name no licence, or a family of them; read in their own files.
_READ = {
    "apsw": "any that the OSI approves",
    "cffi": "MIT-0",
    "contourpy": "BSD-3-Clause",
    "cycler": "BSD-3-Clause",
    "executorlib": "BSD-3-Clause",
    "jinja2": "BSD-3-Clause",
    "kiwisolver": "BSD-3-Clause",
    "lz4": "BSD-3-Clause",
    "markdown-it-py": "MIT",
    "matplotlib": "PSF-2.0 (matplotlib's own text)",
    "mdurl": "MIT",
    "numba": "BSD-2-Clause",
    "pandas": "BSD-3-Clause",
    "partd": "BSD-3-Clause",
    "pycparser": "BSD-3-Clause",
    "pyopengl": "BSD (which one its files do not say)",
    "pysqa": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
    "tomli-w": "MIT",
    "zict": "BSD-3-Clause",
}

_HEAD = """\
# Licences

jointid is under the Apache License 2.0. It is installed with the packages below and contains none of their code. One
of them is not permissive: npTDMS, which reads TDMS files, is under the LGPL; it is in the extra `logs` and is imported
when a TDMS file is read. The core works, and may be passed on, without it.

| package | needed by | licence |
|---|---|---|
"""


def pinned() -> dict[str, str]:
    """Return the version of every package of requirements.txt by its name."""
    rows = re.findall(r"^([\w.-]+)==([\w.]+)", PINNED.read_text(encoding="utf-8"), re.MULTILINE)
    return {name.lower(): version for name, version in rows}


def licence(name: str) -> str:
    """Return a package's licence as it says itself.

    Raises:
        ValueError: neither its metadata nor this file name one.
    """
    if name in _READ:
        return _READ[name]
    said = metadata(name)
    short = next((said[key] for key in ("License-Expression", "License") if key in said), "")
    if not short or len(short) > 60:
        raise ValueError(
            f"The metadata of {name} name no licence; read its files, and put it into {Path(__file__).name}."
        )
    return short


def needed_by() -> dict[str, set[str]]:
    """Return who needs a package, the core or extras, through whatever other package."""
    found: dict[str, set[str]] = {}

    def follow(name: str, extras: set[str], who: str) -> None:
        try:
            needs = [Requirement(text) for text in requires(name) or ()]
        except PackageNotFoundError:  # on another platform
            return
        for need in needs:
            key = re.sub(r"[._]+", "-", need.name).lower()
            wanted = need.marker is None or any(need.marker.evaluate({"extra": extra}) for extra in (*extras, ""))
            if key == "jointid":
                if wanted:
                    follow("jointid", set(need.extras), who)
            elif wanted and who not in found.setdefault(key, set()):
                found[key].add(who)
                follow(key, set(need.extras), who)

    follow("jointid", set(), "core")
    for extra in EXTRAS:
        follow("jointid", {extra}, extra)
    return found


def table() -> str:
    """Return the page."""
    users = needed_by()
    rows = []
    for name in sorted(pinned()):
        who = users.get(name, set())
        said = "core" if "core" in who else ", ".join(extra for extra in EXTRAS if extra in who)
        rows.append(f"| {name} | {said or 'another platform'} | {licence(name)} |\n")
    return _HEAD + "".join(rows)


def main() -> int:
    """Write the page, or say whether it is up to date."""
    if sys.argv[1:] == ["write"]:
        PAGE.write_text(table(), encoding="utf-8")
        return 0
    if sys.argv[1:] == ["check"]:
        return int(PAGE.read_text(encoding="utf-8") != table())
    sys.exit("Say write or check.")


if __name__ == "__main__":
    sys.exit(main())
