"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from . import controller, friction, robots, spring
from .common.errors import ExtraError, JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import load
from .controller_id.learn import learn_controller
from .diagnostics.compare import compare
from .diagnostics.diagnose import diagnose
from .diagnostics.identify import identify
from .diagnostics.intervals import intervals
from .diagnostics.validation import validate
from .estimation.methods.didim import DIDIM
from .estimation.methods.drive_side import DriveSideFit
from .estimation.methods.idim import IDIM
from .estimation.problems.log_windows import Windowing
from .estimation.problems.several_records import SeveralRecords
from .estimation.result.estimate import Estimate
from .estimation.robots.payload import identify_payload
from .models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from .models.limits import AxisLimits
from .models.position_forces import Gravity
from .models.robots.robot import Robot
from .output import figures
from .output.export import export, state_space
from .output.json import load_estimate, to_dict
from .output.report import Report
from .paper.twin import twin
from .planning.design import design
from .planning.predict import Noise
from .records.chunks import Log
from .records.columns import Column
from .records.drives import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Record
from .records.signals.filtering import Filtering
from .records.writing import write
from .simulation import excitation
from .simulation.controller_torque import compute_controller_torque
from .simulation.prescribed import DriveSide
from .simulation.synthesis import simulate, simulated_record
from .tuning.proposals import Tuning
from .tuning.tune import tune

__version__: str
__all__ = [
    "DIDIM",
    "IDIM",
    "AxisLimits",
    "Channel",
    "ClosedLoop",
    "Column",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "ExtraError",
    "Filtering",
    "FlexibleJoint",
    "Gravity",
    "JointFileError",
    "JointidError",
    "Log",
    "MethodError",
    "Noise",
    "Record",
    "RecordError",
    "Report",
    "RigidJoint",
    "Robot",
    "SeveralRecords",
    "Transmission",
    "Tuning",
    "Windowing",
    "compare",
    "compute_controller_torque",
    "controller",
    "design",
    "diagnose",
    "excitation",
    "export",
    "figures",
    "friction",
    "identify",
    "identify_payload",
    "inspect",
    "intervals",
    "learn_controller",
    "load",
    "load_estimate",
    "read",
    "robots",
    "simulate",
    "simulated_record",
    "spring",
    "state_space",
    "to_dict",
    "tune",
    "twin",
    "validate",
    "write",
]
