"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from .common.errors import ExtraError, JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import JointFile, load
from .controller_id.learn import learn_loop
from .diagnostics.check_loop import check_loop
from .diagnostics.compare_estimates import compare_estimates
from .diagnostics.examine_record import examine
from .diagnostics.experiment_design import advise, design_stiffness_test
from .diagnostics.friction_comparison import compare_frictions
from .diagnostics.identify import identify
from .diagnostics.intervals import intervals
from .diagnostics.method_comparison import compare_methods
from .diagnostics.spring_comparison import compare_springs
from .diagnostics.validation import Validation, validate
from .estimation.methods.didim import DIDIM
from .estimation.methods.flexible import FlexibleDIDIM
from .estimation.methods.idim import IDIM
from .estimation.methods.prescribed import DriveSideFit, OpenLoopFit
from .estimation.problems.log_windows import Windowing
from .estimation.problems.several_records import SeveralRecords
from .estimation.result.estimate import Estimate
from .models.controllers import PD, PID, Cascade, StateSpaceController, filters
from .models.friction import AsymmetricFriction, SymmetricFriction
from .models.gravity import Counterbalance, Gravity
from .models.joints import ClosedLoop, FlexibleJoint, RigidJoint
from .output import figures
from .output.export import export, state_space
from .output.json import read_report
from .output.json.documents import to_dict
from .output.report import Report
from .paper.twin import twin
from .planning.design import design_test
from .planning.foretell import Noise, foretell, planned_record
from .planning.limits import AxisLimits
from .records.chunks import Log
from .records.columns import Column
from .records.drives import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Record
from .records.signals.filtering import Filtering
from .records.writing import convert, write
from .simulation import excitation
from .simulation.closed_loop import simulate
from .simulation.loop_input import prepare
from .simulation.prescribed import DriveSide, OpenLoop
from .simulation.synthesis import simulated_record
from .tuning.proposals import Tuning
from .tuning.tune import tune

__version__: str
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "PID",
    "AsymmetricFriction",
    "AxisLimits",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "Counterbalance",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "ExtraError",
    "Filtering",
    "FlexibleDIDIM",
    "FlexibleJoint",
    "Gravity",
    "JointFile",
    "JointFileError",
    "JointidError",
    "Log",
    "MethodError",
    "Noise",
    "OpenLoop",
    "OpenLoopFit",
    "Record",
    "RecordError",
    "Report",
    "RigidJoint",
    "SeveralRecords",
    "StateSpaceController",
    "SymmetricFriction",
    "Transmission",
    "Tuning",
    "Validation",
    "Windowing",
    "advise",
    "check_loop",
    "compare_estimates",
    "compare_frictions",
    "compare_methods",
    "compare_springs",
    "convert",
    "design_stiffness_test",
    "design_test",
    "examine",
    "excitation",
    "export",
    "figures",
    "filters",
    "foretell",
    "identify",
    "inspect",
    "intervals",
    "learn_loop",
    "load",
    "planned_record",
    "prepare",
    "read",
    "read_report",
    "simulate",
    "simulated_record",
    "state_space",
    "to_dict",
    "tune",
    "twin",
    "validate",
    "write",
]
