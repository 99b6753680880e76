"""A learned controller as a part of a joint file."""

from __future__ import annotations

from pathlib import Path

from jointid.common.errors import JointFileError
from jointid.config import JointFile, with_controller, with_paths
from jointid.controller_id.learned import LearnedLoop


def save(learned: LearnedLoop, file: JointFile, path: Path) -> None:
    """Write a joint file with its [controller] the learned one; all else of its text, comments too, stays as it is.

    But for the paths of records: in another folder they lead to the same files from there.

    Args:
        learned: the controller.
        file: the joint file, loaded from a path: its text is taken from there.
        path: to write to; a file that is there is replaced.

    Raises:
        JointFileError: a file cannot be read or written.
    """
    try:
        text = file.path.read_text(encoding="utf-8-sig")
        made = with_controller(text, learned.controller, file.joint.transmission)
        made = with_paths(made, file.path.parent, path.parent)
        path.write_text(made, encoding="utf-8", newline="\n")
    except OSError as error:
        raise JointFileError(f"{error.filename} cannot be used ({error.strerror}); check the folder.") from error
