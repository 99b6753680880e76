"""The joint file and the robot file (TOML): joint, record and method."""

from jointid.config.axis import Axis
from jointid.config.file import File
from jointid.config.loading import controller_text, dumps, load, loads, save_with_controller
from jointid.config.tables import Run, Source
from jointid.config.toml import edit, move_paths, replace_table

__all__ = [
    "Axis", "File", "Run", "Source", "controller_text", "dumps", "edit", "load", "loads", "move_paths",
    "replace_table", "save_with_controller",
]  # fmt: skip
