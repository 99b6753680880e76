"""One axis behind a gear or a screw, as its motor sees it: what the tests of transmissions share."""

from jointid.common.transmission import Transmission
from jointid.models.controllers import Cascade

RATE = 1e-3
LAW = Cascade(position_gain=25.0, velocity_gain=0.02, limit=3.0)
"""On the motor's side, where a drive closes its loops."""

SCREW = Transmission(load="prismatic", lead=0.010)
TURNED_SCREW = Transmission(load="prismatic", lead=0.010, sign=-1)

RIGID = {"inertia": 2e-4, "viscous": 1e-3, "coulomb": 0.03, "offset": 0.02}
FLEXIBLE = {
    "motor_inertia": 1.2e-4, "motor_viscous": 6e-4, "motor_coulomb": 0.02, "stiffness": 1.5, "damping": 3e-4,
    "load_inertia": 0.8e-4, "load_viscous": 4e-4, "load_coulomb": 0.01, "offset": 0.02,
}  # fmt: skip
