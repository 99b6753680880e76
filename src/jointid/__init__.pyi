"""The public names and where they live: the one list, which `__init__.py` loads them by."""

from .common.errors import ExtraError, JointFileError, JointidError, MethodError, RecordError
from .common.transmission import Transmission
from .config import JointFile, load
from .controller_id.learn import learn_loop
from .diagnostics.check_loop import check_loop
from .diagnostics.compare_estimates import compare_estimates
from .diagnostics.experiment_design import advise, design_stiffness_test
from .diagnostics.intervals import intervals
from .diagnostics.method_comparison import compare_methods
from .diagnostics.validation import Validation, validate
from .estimation.identify import identify
from .estimation.methods.didim import DIDIM
from .estimation.methods.drive_side import DriveSideFit
from .estimation.methods.flexible import FlexibleDIDIM
from .estimation.methods.idim import IDIM
from .estimation.methods.open_loop import OpenLoopFit
from .estimation.problems.log_windows import Windowing
from .estimation.problems.several_records import SeveralRecords
from .estimation.result.estimate import Estimate
from .models.controllers import PD, PID, Cascade, StateSpaceController, filters
from .models.friction import AsymmetricFriction, SymmetricFriction
from .models.gravity import Counterbalance, Gravity
from .models.joints import FlexibleJoint, RigidJoint, frequencies, rigid_sums
from .output.export import export, state_space
from .output.figures import residual_figure, torque_figure
from .output.json import read_report
from .output.json.documents import to_dict
from .output.report.report import Report, report_estimate
from .paper.twin import twin
from .records.chunks import Log
from .records.columns import Column
from .records.converting import convert
from .records.drives.drive import Drive
from .records.inspection import inspect
from .records.reading import read
from .records.record import Channel, Record
from .records.signals.excitation import pulses, trapezoids
from .records.signals.filtering import Filtering
from .records.writing import write
from .simulation.closed_loop import simulate
from .simulation.drive_side import DriveSide
from .simulation.loop_input import ClosedLoop, prepare
from .simulation.open_loop import OpenLoop
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
    "compare_methods",
    "convert",
    "design_stiffness_test",
    "export",
    "filters",
    "frequencies",
    "identify",
    "inspect",
    "intervals",
    "learn_loop",
    "load",
    "prepare",
    "pulses",
    "read",
    "read_report",
    "report_estimate",
    "residual_figure",
    "rigid_sums",
    "simulate",
    "simulated_record",
    "state_space",
    "to_dict",
    "torque_figure",
    "trapezoids",
    "tune",
    "twin",
    "validate",
    "write",
]
