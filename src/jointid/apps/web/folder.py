"""A folder of the page: records with what its forms say, or an identification; and the bounds of its work.

Names that begin with `_` are the page's own; no upload has such a name.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jointid.common.errors import JointidError
from jointid.common.files import write_whole

UPLOAD = 256 * 2**20
"""Bytes of one upload."""
MEMORY = 5 * 2**30
"""Bytes of addresses of each process that reads or identifies, on Linux."""
READING, IDENTIFYING = 300.0, 3600.0
"""Seconds after which reading a record, and each command of an identification, is stopped."""
MODELS = (".urdf", ".xml", ".mjcf")
"""Suffixes of a robot's model."""


class PageError(JointidError):
    """A request that the page refuses, in a sentence."""


@dataclass(frozen=True, slots=True)
class Draft:
    """A folder of records with what the forms say of them, or a run with its joint file or robot file."""

    path: Path

    @property
    def files(self) -> list[str]:
        """Names of the files that are not the page's own."""
        return sorted(one.name for one in self.path.glob("*") if not one.name.startswith("_") and self.has(one.name))

    @property
    def robot(self) -> bool:
        """Whether it is of a robot, whose model is there."""
        return any(name.lower().endswith(MODELS) for name in self.files)

    @property
    def file(self) -> str:
        """The name of its joint file or robot file."""
        return "robot.toml" if self.robot else "joint.toml"

    @property
    def records(self) -> list[str]:
        """Names of its records."""
        return [name for name in self.files if not name.lower().endswith((".toml", *MODELS))]

    @property
    def texts(self) -> dict[str, str]:
        """Texts of the forms by the keys of their fields."""
        return {key: text for key, text in self.json("_texts.json").items() if type(text) is str}

    def enter(self, texts: Mapping[str, str]) -> None:
        """Keep what is entered in the forms."""
        self.path.mkdir(parents=True, exist_ok=True)
        self.write_json("_texts.json", texts)

    def has(self, name: str) -> bool:
        """Return whether it has a file of its own by this name."""
        path = self.path / name
        return path.is_file() and not path.is_symlink()

    def read(self, name: str) -> str:
        """Return the text of a file; empty without it."""
        return (self.path / name).read_text("utf-8", "replace") if self.has(name) else ""

    def json(self, name: str) -> dict[str, Any]:
        """Return a file as JSON; empty if it is missing or damaged."""
        try:
            found = json.loads(self.read(name))
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_json(self, name: str, value: Mapping[str, Any]) -> None:
        """Write one of the page's own files."""
        write_whole(self.path / name, json.dumps(value, allow_nan=False))
