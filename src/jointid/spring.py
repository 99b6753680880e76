"""Springs between motor and load, `ji.spring.Spring("backlash")`, and the counterbalance of a load."""

from jointid.models.position_forces import Counterbalance
from jointid.models.springs import Spring

__all__ = ["Counterbalance", "Spring"]
