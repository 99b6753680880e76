"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from . import controller, friction, robots, spring
from .common.errors import JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import load
from .controller_id.learn import learn_controller
from .diagnostics.analysis import intervals
from .diagnostics.compare import compare
from .diagnostics.diagnose import diagnose
from .diagnostics.identify import identify
from .diagnostics.validation import validate
from .estimation.methods.didim import DIDIM
from .estimation.methods.drive_side import DriveSideFit
from .estimation.methods.idim import IDIM
from .estimation.result.estimate import Estimate
from .models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from .models.limits import AxisLimits
from .models.position_forces import Gravity
from .output import figures
from .output.export import export, state_space
from .output.json import load_estimate, to_dict
from .output.report import Report
from .paper.twin import twin
from .planning.design import design
from .records.columns import Column
from .records.drives import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Record
from .records.signals.filtering import Filtering
from .records.writing import write
from .simulation import excitation
from .simulation.synthesis import simulate, simulated_record
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
    "DriveSideFit",
    "Estimate",
    "Filtering",
    "FlexibleJoint",
    "Gravity",
    "JointFileError",
    "JointidError",
    "MethodError",
    "Record",
    "RecordError",
    "Report",
    "RigidJoint",
    "Transmission",
    "compare",
    "controller",
    "design",
    "diagnose",
    "excitation",
    "export",
    "figures",
    "friction",
    "identify",
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
