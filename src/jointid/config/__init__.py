"""The joint file and the robot file (TOML): what is identified, from which record, and how."""

from jointid.config.file import Axis, File
from jointid.config.loading import dumps, file_of, load, load_joint, load_to_learn, loads, require_joint
from jointid.config.serialise import controller_text, learned_text, save_with_controller
from jointid.config.source import Run, Source, Together
from jointid.config.toml import with_paths, with_record, with_table

__all__ = [
    "Axis", "File", "Run", "Source", "Together", "controller_text", "dumps", "file_of", "learned_text", "load",
    "load_joint", "load_to_learn", "loads", "require_joint", "save_with_controller", "with_paths",
    "with_record", "with_table",
]  # fmt: skip
