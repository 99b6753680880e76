"""The joint file and the robot file (TOML): what is identified, from which record, and how."""

from jointid.config.contents import JointFile
from jointid.config.loading import dumps, load, load_joint, load_to_learn, loads, require_joint
from jointid.config.serialise import controller_text, learned_text, save_with_controller
from jointid.config.source import Run, Source, Together
from jointid.config.toml import with_paths, with_record, with_table

__all__ = [
    "JointFile", "Run", "Source", "Together", "controller_text", "dumps", "learned_text", "load",
    "load_joint", "load_to_learn", "loads", "require_joint", "save_with_controller", "with_paths",
    "with_record", "with_table",
]  # fmt: skip
