"""Springs between motor and load, `FlexibleJoint("revolute", spring=Backlash())`, and the counterbalance of a load."""

from jointid.models.position_forces import Counterbalance
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
