"""Exports of an identified joint: a function for each language of another tool, and the verb that chooses one."""

from jointid.output.export.languages import LANGUAGES, Export, export, find_language, read_estimated, state_space

__all__ = ["LANGUAGES", "Export", "export", "find_language", "read_estimated", "state_space"]
