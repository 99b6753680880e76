"""The laws there are, by the word for them in a joint file.

A law is added by its own file and its line here: its keys in the joint file, their checks and their documentation are
made from the settings that it declares.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jointid.models.controllers.laws import PD, PID, Cascade
from jointid.models.controllers.state_space import StateSpaceController

LAWS: Mapping[str, type[Any]] = {"cascade": Cascade, "pd": PD, "pid": PID, "state_space": StateSpaceController}
"""The class of each law."""
