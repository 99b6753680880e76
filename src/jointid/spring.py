"""Springs between motor and load, and the counterbalance of a load: `ji.FlexibleJoint(spring=ji.spring.Backlash())`."""

from jointid.models.gravity import Counterbalance
from jointid.models.springs import (
    Backlash,
    CubicSpring,
    ElasticLoad,
    HystereticSpring,
    LinearSpring,
    ThreePieceSpring,
    TwoPieceSpring,
)

__all__ = [
    "Backlash", "Counterbalance", "CubicSpring", "ElasticLoad", "HystereticSpring", "LinearSpring",
    "ThreePieceSpring", "TwoPieceSpring",
]  # fmt: skip
