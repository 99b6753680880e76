"""The joint file (TOML): what is identified, from which record, and how; checked completely before anything runs."""

from jointid.config.contents import JointFile
from jointid.config.loading import (
    controller_text,
    dumps,
    load,
    loads,
    save,
    save_with_controller,
    with_controller,
    with_parameters,
    with_paths,
)
from jointid.config.schema import json_schema
from jointid.config.schema_record import Run, Source, Together

__all__ = [
    "JointFile", "Run", "Source", "Together", "controller_text", "dumps", "json_schema", "load", "loads", "save",
    "save_with_controller", "with_controller", "with_parameters", "with_paths",
]  # fmt: skip
