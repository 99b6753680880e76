"""The joint file (TOML): what is identified, from which record, and how; checked completely before anything runs."""

from jointid.config.contents import JointFile
from jointid.config.loading import (
    controller_text,
    dumps,
    learned_text,
    load,
    load_to_learn,
    loads,
    save,
    save_with_controller,
    with_paths,
    with_record,
    with_table,
)
from jointid.config.schema import json_schema
from jointid.config.schema_record import Run, Source, Together

__all__ = [
    "JointFile", "Run", "Source", "Together", "controller_text", "dumps", "json_schema", "learned_text", "load",
    "load_to_learn", "loads", "save", "save_with_controller", "with_paths", "with_record", "with_table",
]  # fmt: skip
