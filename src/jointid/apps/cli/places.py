"""Output files of a command by option, checked before anything runs."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from itertools import combinations
from pathlib import Path

from jointid.common.errors import RecordError
from jointid.common.files import require_room

_OF_FOLDERS = (".html", ".md", ".png", ".svg", ".csv", ".mat")


class Outputs:
    """The files that a command writes; no two are one, each can be written, and none is what the command reads.

    Args:
        files: path by option, None where it was not given.
        figures: likewise, of files whose suffix says a picture's format.
        folders: likewise, of folders that are made, or written into.

    Raises:
        RecordError: a file's folder does not exist, a place takes nothing, as one that is read-only or full, the file
            is a folder or is read-only, a figure has no format, or two are one file.
    """

    def __init__(
        self,
        files: Mapping[str, Path | None] | None = None,
        figures: Mapping[str, Path | None] | None = None,
        folders: Mapping[str, Path | None] | None = None,
    ) -> None:
        pictures, self._folders = _drop_missing(figures), _drop_missing(folders)
        self._files = _drop_missing(files) | pictures
        for path in self._files.values():
            if not path.absolute().parent.is_dir():
                raise RecordError(f"{path} cannot be written, because there is no folder {path.parent}; make it first.")
            if path.is_dir():
                raise RecordError(f"{path} cannot be written, because it is a folder; name a file in it.")
            if path.exists() and not os.access(path, os.W_OK):
                raise RecordError(f"{path} cannot be written, because it is read-only; name another file.")
            require_room(path)
        for path in self._folders.values():
            require_room(path)
        for path in pictures.values():
            from jointid.output.figures import require_format

            require_format(path)
        for (one, first), (other, second) in combinations({**self._files, **self._folders}.items(), 2):
            if _is_same(first, second) and not {one, other} <= self._folders.keys():  # whose files are the same, or two
                raise RecordError(f"{one} and {other} are both {first}; name two places.")

    def spare(self, what: str, *inputs: Path | None) -> None:
        """Refuse to write over what is read; a folder stands for the files in it.

        Args:
            what: the option or the argument that names it.
            inputs: the files; None is none.

        Raises:
            RecordError: an output is one of them, by whatever name.
        """
        for path in _each_file(inputs):
            for option, out in self._files.items():
                if path.exists() and _is_same(out, path):
                    raise RecordError(
                        f"{option} {out} is the file that {what} names, which would be replaced; name another file."
                    )
            for option, folder in self._folders.items():
                if path.suffix.lower() in _OF_FOLDERS and folder.exists() and folder.samefile(path.absolute().parent):
                    raise RecordError(
                        f"{option} {folder} is the folder of the file that {what} names, {path.name}, which might be "
                        "replaced; name another folder."
                    )


def _drop_missing(paths: Mapping[str, Path | None] | None) -> dict[str, Path]:
    return {option: path for option, path in (paths or {}).items() if path is not None}


def _each_file(paths: Iterable[Path | None]) -> Iterable[Path]:
    for path in paths:
        if path is not None:
            yield path
            if path.is_dir():
                yield from path.iterdir()


def _is_same(one: Path, other: Path) -> bool:
    """Return whether two paths lead to one file, through links too; a device or a pipe can be named twice."""
    try:
        if one.exists() and other.exists():
            return one.is_file() and one.samefile(other)
    except OSError:
        return False
    return os.path.normcase(os.path.realpath(one)) == os.path.normcase(os.path.realpath(other))


NOTHING = Outputs()
"""The outputs of a command without any."""
