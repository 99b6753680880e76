"""Faults of a joint file: the key, what was received, what was expected, the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointid.common.errors import JointFileError
from jointid.common.messages import dot_path
from jointid.config import (
    load,
    loads,
)
from tests.joint_files import (
    BOTH_ENCODERS,
    CASCADE,
    CHANNELS,
    FLEXIBLE,
    JOINT,
    LINK,
    SMALLEST,
    faults,
)

FAULTS = [
    # keys
    (
        SMALLEST + "position_gian = 3",
        "controller.position_gian is not a known key; expected one of law, side, gain, limit, period, delay, "
        "interpolation, reference_average, reference_delay, velocity_filter, torque_filters, "
        "acceleration_feedforward, viscous_feedforward, coulomb_feedforward, constant_feedforward, "
        "undeclared, "
        "position_gain, velocity_gain, integral_gain, anti_windup, velocity_feedforward, "
        "reference_velocity, velocity_limit, position_period, "
        "position_offset, integral_time: did you mean position_gain?",
    ),
    (
        SMALLEST.replace("velocity_gain = 2000.0", "derivative_gain = 3.0\nintegral_gain = 1.0").replace(
            "cascade", "pd"
        ),
        "controller.integral_gain is not a known key; expected one of law, side, gain, limit, period, delay, "
        "interpolation, reference_average, "
        "reference_delay, velocity_filter, torque_filters, acceleration_feedforward, viscous_feedforward, "
        "coulomb_feedforward, constant_feedforward, undeclared, position_gain, "
        "derivative_gain, reference_velocity, derivative_time: leave it out.",
    ),
    (
        SMALLEST + "[methods]",
        "methods is not a known key; expected one of joint, transmission, gravity, ripple, record, drive, controller, "
        "filtering, method, parameters, records, together, limits: did you mean method?",
    ),
    (
        SMALLEST.replace("motor_position", "motor_positon"),
        "record.channels.motor_positon is not a known key; expected one of torque, reference, reference_velocity,"
        " motor_position, load_position, injected: did you mean motor_position?",
    ),
    (
        SMALLEST + '["a.b"]',
        '"a.b" is not a known key; expected one of joint, transmission, gravity, ripple, record, drive, controller, '
        "filtering, method, parameters, records, together, limits: leave it out.",
    ),
    (
        SMALLEST.replace("position_gain = 100.0\n", ""),
        "controller.position_gain is missing; expected a number, 0 or more (position gain [1/s]): add it.",
    ),
    (
        SMALLEST.replace(JOINT, "[joint]\n"),
        'joint.kind is missing; expected "prismatic" or "revolute" (how the joint moves: m and N, or rad and N '
        "m): add it.",
    ),
    (
        CHANNELS + CASCADE,
        "joint is missing; expected a table (what is identified): add it.",
    ),
    # words
    (
        SMALLEST.replace('"prismatic"', '"linear"'),
        'joint.kind is "linear"; expected "prismatic" or "revolute": choose one of them.',
    ),
    (
        SMALLEST.replace('"cascade"', '"cascad"'),
        'controller.law is "cascad"; expected "cascade", "pd", "pid" or "state_space": did you mean "cascade"?',
    ),
    (
        SMALLEST.replace('law = "cascade"\n', ""),
        'controller.law is missing; expected "cascade", "pd", "pid" or "state_space" (the controller\'s law): add it.',
    ),
    (
        SMALLEST.replace('"cascade"', "[1]"),
        'controller.law is [1]; expected "cascade", "pd", "pid" or "state_space": choose one of them.',
    ),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "dahl"'),
        'joint.friction: Friction "dahl" is not known; use symmetric, asymmetric, stribeck, asymmetric-stribeck, '
        "presliding, load-dependent, asymmetric-load-dependent, presliding-load-dependent, drifting.",
    ),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nmodel = "flexible"\nfriction = "stribeck"\nspring = "cubic"'),
        'joint.friction: The laws "stribeck" and "cubic" of friction and spring are not simulated beside each other: '
        "one is in pieces, the other is smooth; use a linear spring, or symmetric friction, beside one of them.",
    ),
    # values
    (
        SMALLEST.replace("position_gain = 100.0", 'position_gain = "160.18"'),
        'controller.position_gain is "160.18"; expected a number, 0 or more: write it without quotes.',
    ),
    (
        SMALLEST.replace("position_gain = 100.0", "position_gain = -3"),
        "controller.position_gain is -3; expected a number, 0 or more: turn the torque or the positions round, with "
        "sign = "
        "-1 on their channels.",
    ),
    (
        SMALLEST.replace("position_gain = 100.0", "position_gain = nan"),
        "controller.position_gain is nan; expected a number, 0 or more: correct it.",
    ),
    (
        SMALLEST + "gain = -1.5",
        "controller.gain is -1.5; expected a positive number: turn the torque round, with sign = -1 on its channel.",
    ),
    (
        SMALLEST + "limit = 0",
        "controller.limit is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + "period = inf",
        "controller.period is inf; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + "velocity_filter = 0.5",
        "controller.velocity_filter is 0.5; expected a list of one or more numbers, or a table: correct it.",
    ),
    (
        SMALLEST + 'velocity_filter = [0.5, "a"]',
        'controller.velocity_filter is [0.5, "a"]; expected a list of one or more numbers, or a table: correct it.',
    ),
    (
        SMALLEST + "velocity_filter = { numerator = [] }",
        "controller.velocity_filter.numerator is []; expected a list of one or more numbers: correct it, or leave it "
        "out.",
    ),
    (
        SMALLEST + "velocity_filter = { numerator = [1], denominator = [0.0] }",
        "controller.velocity_filter.denominator: A digital filter needs a numerator, and a denominator that does "
        "not start with 0, of finite numbers; received (1.0,) / (0.0,).",
    ),
    (
        SMALLEST + "velocity_filter = { frequency = 80.0, samples = 3 }",
        'controller.velocity_filter.kind is missing; expected "digital", "moving_average", "first_order", '
        '"second_order" or "notch" (which filter): add it.',
    ),
    (
        SMALLEST + 'velocity_filter = { kind = "lowpass" }',
        'controller.velocity_filter.kind is "lowpass"; expected "digital", "moving_average", "first_order", '
        '"second_order" or "notch": choose one of them.',
    ),
    (
        SMALLEST + "velocity_filter = {}",
        "controller.velocity_filter.numerator is missing; expected a list of one or more numbers (of digital: b0, b1, "
        "... in powers of 1/z): add it.",
    ),
    (
        SMALLEST + 'torque_filters = [[0.5, 0.5], { kind = "notch", frequency = 80 }]',
        "controller.torque_filters.1.bandwidth is missing; expected a positive number (of notch: width, between "
        "the points where a notch of depth 0 passes 71 % [Hz]): add it.",
    ),
    (
        SMALLEST + 'torque_filters = [{ kind = "first_order", time_constant = 0.001, frequency = 80 }]',
        'controller.torque_filters.0.frequency is not a key of the kind "first_order"; expected one of time_constant: '
        "leave it out, or change the kind.",
    ),
    (
        SMALLEST + 'torque_filters = [{ kind = "notch", frequency = -80, bandwidth = 20 }]',
        "controller.torque_filters.0.frequency is -80; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + 'torque_filters = { kind = "notch", frequency = 80, bandwidth = 20 }',
        "controller.torque_filters is a table; expected a list of filters, each a table or the list of a numerator: "
        "correct it, or leave it out.",
    ),
    (
        SMALLEST + 'period = 0.01\ntorque_filters = [{ kind = "notch", frequency = 80, bandwidth = 20 }]',
        "controller: A filter at 80 Hz does not exist at a period of 0.01 s, whose half sampling frequency is 50 Hz; "
        "lower it, or correct the period.",
    ),
    (
        SMALLEST + 'velocity_filter = { kind = "second_order", frequency = 80, numerator_damping = -1.5 }',
        "controller.velocity_filter.numerator_damping is -1.5; expected a number above -1: correct it, or leave it "
        "out.",
    ),
    (
        SMALLEST + "period = 0.001\nposition_period = 0.0025",
        "controller: The position loop's period is a multiple of the controller's, up to 64 times; received 0.0025 s "
        "beside 0.001 s: correct one of them.",
    ),
    (
        SMALLEST + "period = 1e-9\nreference_delay = 1.0",
        "controller: A delay of the reference is one of 400 periods at most; received 1 s beside a period of 1e-09 s: "
        "correct one of them.",
    ),
    (
        SMALLEST + "velocity_limit = 0",
        "controller.velocity_limit is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST + 'anti_windup = "clamp"',
        'controller.anti_windup is "clamp"; expected "hold", "track" or "none": choose one of them.',
    ),
    (
        SMALLEST + 'interpolation = "zoh"',
        'controller.interpolation is "zoh"; expected "hold", "linear" or "cubic": choose one of them.',
    ),
    (
        SMALLEST.replace("velocity_gain = 2000.0", "derivative_gain = 3.0").replace("cascade", "pid"),
        "controller.integral_gain is missing; expected a number, 0 or more (integral gain [controller units per m s "
        "or rad s]): "
        "add it, or integral_time.",
    ),
    (
        SMALLEST + 'velocity_filter = [0.5, 0.5]\n[method]\nfree = ["position_gain", "velocity_filter.time_constant"]',
        'method.free: Nothing around this joint is called "velocity_filter.time_constant"; what can be freed is '
        "initial_position, initial_velocity, drive_gain, log_gain, log_delay, gain, limit, delay, reference_delay, "
        "acceleration_feedforward, viscous_feedforward, coulomb_feedforward, constant_feedforward, "
        "position_gain, velocity_gain, integral_gain, velocity_feedforward, velocity_limit.",
    ),
    (
        SMALLEST + '[together]\nfree = ["integral_gain"]',
        "together.free: The integral_gain of this controller is 0, so it has no such part; declare a start above 0.",
    ),
    (
        SMALLEST.replace('"i"', '"i", gain = -3.0'),
        "record.channels.torque.gain is -3.0; expected a positive number: use sign = -1 to turn the channel round.",
    ),
    (
        SMALLEST.replace('"i"', '"i", gain = 0'),
        "record.channels.torque.gain is 0; expected a positive number: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", sign = true'),
        "record.channels.torque.sign is true; expected 1 or -1: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", sign = -2'),
        "record.channels.torque.sign is -2; expected 1 or -1: use gain to scale.",
    ),
    (
        SMALLEST.replace('"i"', '"i", optional = "true"'),
        'record.channels.torque.optional is "true"; expected true or false: write it without quotes.',
    ),
    (
        SMALLEST.replace('"i"', "3"),
        "record.channels.torque.column is 3; expected text in quotes: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", at = "after_limit"'),
        "record.channels.torque.at is not a known key; expected one of column, unit, gain, sign, timing, "
        "sample_time, side, wrap, update_time, optional, time, tap: leave it out.",
    ),
    (
        SMALLEST.replace('{ column = "i" }', '"i"'),
        'record.channels.torque is "i"; expected a table: put its keys below a [heading], or in braces.',
    ),
    (
        SMALLEST + "[[method]]",
        "method is a list of lists or tables; expected a table: put its keys below a [heading], or in braces.",
    ),
    (
        "[record]\ntime_unit = 'sec'\n" + SMALLEST,
        'record.time_unit is "sec"; expected "s", "ms", "us", "ns", "min" or "h": did you mean "s"?',
    ),
    (
        "[record]\ndelimiter = 'ab'\n" + SMALLEST,
        "record.delimiter: The delimiter is one character, such as \";\"; got 'ab'.",
    ),
    (
        "[record]\nfile = 'run.xyz'\n" + SMALLEST,
        'record.file: run.xyz has the suffix ".xyz", which names no known format (CSV: .csv, .txt, .tsv, .dat; '
        "MAT: .mat; NPY: .npy; NPZ: .npz; JSON: .json, .jsonl, .ndjson; "
        "HDF5: .h5, .hdf5, .hdf; Parquet: .parquet, .pq; TDMS: .tdms; ROS 2 bag: .mcap, .db3).",
    ),
    (
        "[record]\nfile = 'run.mat'\ndecimal = ','\n" + SMALLEST,
        "record.file: Reading MAT has no option decimal; it has: version.",
    ),
    (
        SMALLEST + "[filtering]\nborders = [1, 2, 3]",
        "filtering.borders is [1, 2, 3]; expected a list of two whole numbers, 0 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[filtering]\ndecimation = 2.5",
        "filtering.decimation is 2.5; expected a whole number, 1 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[method]\niterations = 0xffffffffffffffff",
        "method.iterations is a whole number of more than 64 bits; expected a whole number, 1 or more: correct it, or "
        "leave it out.",
    ),
    # values together
    (
        SMALLEST.replace(
            "[controller]", 'injected = { column = "x", at = "before_limit", in_torque = false }\n[controller]'
        ),
        "record.channels.injected.in_torque: A signal injected before the limit is part of the controller's "
        "output, so the logged torque contains it; set in_torque = true, or at = after_limit.",
    ),
    (
        SMALLEST + '[filtering]\npreset = "published"\ncutoff = 3.0',
        'filtering.cutoff is 3.0 beside preset = "published", which sets it: leave one of them out.',
    ),
    (
        SMALLEST + '[method]\npreset = "paper"\nform = "residual"',
        'method.form is "residual" beside preset = "paper", which sets it: leave one of them out.',
    ),
    (
        JOINT + CHANNELS + '[controller]\nlaw = "state_space"\nA = [[1.0, 2.0], [1.0]]\nB = {}\nC = [1.0, 2.0]\nD = {}',
        "controller.A has rows of 2, 1 numbers; expected rows of one length: complete them.",
    ),
    (
        JOINT
        + CHANNELS
        + '[controller]\nlaw = "state_space"\nA = [[1.0]]\nB = { position = [1.0, 2.0] }\nC = [1.0]\nD = {}',
        "controller: A state-space law with 1 states (the length of C) needs A (1, 1) and each column of B (1,), "
        "for the inputs reference, reference_velocity, position, excess; received B.position (2,).",
    ),
    (
        SMALLEST + '[filtering]\npreset = "as-printed"\naliasing = "refused"',
        'filtering.aliasing is "refused" beside preset = "as-printed", which sets it: leave one of them out.',
    ),
    (
        SMALLEST + '[filtering]\naliasing = "refuse"',
        'filtering.aliasing is "refuse"; expected "refused" or "warned": did you mean "refused"?',
    ),
    (
        FLEXIBLE + '[method]\npreset = "paper"\nfrequency = 25.0\nrestarts = 2',
        'method.restarts is 2 beside preset = "paper", which sets it: leave one of them out.',
    ),
    # units
    (
        SMALLEST.replace('"r"', '"r", unit = "deg"'),
        'record.channels.reference.unit is "deg", a unit of angle; expected one of m, mm, cm, um, nm, inch, counts: '
        'give one of them, or set joint.kind = "revolute".',
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "N"'),
        'record.channels.reference.unit is "N", a unit of force; expected one of m, mm, cm, um, nm, inch, counts: give '
        "one of them.",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "clicks"'),
        'record.channels.reference.unit is "clicks", which is not known; expected one of m, mm, cm, um, nm, inch, '
        "counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "milli"'),
        'record.channels.reference.unit is "milli", which is not known; expected one of m, mm, cm, um, nm, inch, '
        "counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace('"r"', '"r [clicks]"'),
        'record.channels.reference.column names the unit "clicks", which is not known; expected one of m, mm, cm,'
        " um, nm, inch, counts: give one of them, and the gain that takes the column to it.",
    ),
    (
        SMALLEST.replace("[controller]", 'injected = { column = "x", unit = "V" }\n[controller]'),
        "record.channels.injected is in V, but the torque in N: give both in one unit.",
    ),
    # the drive
    (
        SMALLEST + '[drive]\nprofile = "abc"',
        'drive.profile: No drive profile is called "abc"; there are cia402, epos, generic, kuka, lerobot, mit, '
        "moteus, pace, ros2, sage, sinamics, twincat, unitree, ur-rtde.",
    ),
    (
        SMALLEST + "[drive]\naxis = 0",
        "drive.axis is 0; expected a whole number, 1 or more: correct it, or leave it out.",
    ),
    (
        SMALLEST.replace(JOINT, JOINT + "torque_constant = 0.7\n") + "[drive]\nrated_torque = 1\nrated_current = 2",
        "drive: The drive's rated_torque is 1, and rated_current x torque_constant 1.4, 1.4 times as much (peak and "
        "rms ampere differ by 1.41); correct one, or leave rated_current out.",
    ),
    (
        SMALLEST.replace('"i"', '"i", unit = "permille"'),
        'record.channels.torque is in "permille", a share of the rated torque, which needs the drive\'s rated_torque: '
        "give it below [drive], or rated_current there and torque_constant below [joint].",
    ),
    (
        SMALLEST.replace('"r"', '"r", unit = "counts"') + "[drive]\ncounts_per_turn = 4096",
        'record.channels.reference is in "counts", which needs the drive\'s counts_per_metre: give it below [drive], '
        "or gain and another unit.",
    ),
    (
        SMALLEST.replace('{ column = "i" }', "{ gain = 2.0 }"),
        "record.channels.torque.column is missing; expected text in quotes (name of the column in the record's file): "
        "add it, or give drive.profile.",
    ),
    (
        SMALLEST.replace('"i"', '"i", wrap = 360'),
        "record.channels.torque has a wrap of 360, which is for a position; leave it out.",
    ),
    # the method
    (
        JOINT + '[record.channels]\ntorque = { column = "i" }',
        "method.name is missing, and no method can be chosen: DIDIM lacks record.channels.reference and "
        "controller, IDIM lacks record.channels.motor_position; add what one of them lacks.",
    ),
    (
        JOINT + CHANNELS + '[method]\nname = "didim"',
        'controller is missing, but DIDIM needs it: add it, or use method.name = "idim", which needs only torque '
        "and motor_position.",
    ),
    (
        JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + '[method]\nname = "idim"',
        'record.channels.motor_position is missing, but IDIM needs it: add it, or use method.name = "didim", '
        "which needs only torque, reference and controller.",
    ),
    (
        JOINT
        + CHANNELS
        + '[controller]\nlaw = "pd"\nposition_gain = 1.0\nderivative_gain = 1.0\nreference_velocity = "channel"',
        'record.channels.reference_velocity is missing, but DIDIM needs it: add it, or use method.name = "idim", '
        "which needs only torque and motor_position.",
    ),
    (
        JOINT + CHANNELS + '[method]\nform = "paper"',
        'method.form is for DIDIM, but the method is IDIM: leave it out, or use method.name = "didim".',
    ),
    # the method of a flexible joint
    *(
        (
            f"{FLEXIBLE}[method]\n{key} = {value}",
            f"method.{key} is for DIDIM of a rigid joint, but the joint is flexible: leave it out, or set "
            'joint.model = "rigid".',
        )
        for key, value in (
            ("form", '"paper"'),
            ("start", '"given"'),
            ("scaled_iterations", 1),
            ("step_tolerance", 1e-3),
            ("iterations", 3),
            ("initial_state", '"free"'),
        )
    ),
    *(
        (
            f"{SMALLEST}[method]\n{key} = {value}",
            f"method.{key} is for DIDIM of a flexible joint, but the joint is rigid: leave it out, or set "
            'joint.model = "flexible".',
        )
        for key, value in (
            ("minimiser", '"nelder-mead"'),
            ("frequency", 30.0),
            ("rigid_cutoff", 5.0),
            ("simulations", 10),
            ("restarts", 0),
            ("statistics", '"sensitivities"'),
        )
    ),
    (
        SMALLEST + '[method]\npreset = "paper"\nfrequency = 30.0',
        "method.frequency is for DIDIM of a flexible joint, but the joint is rigid: leave it out, or set "
        'joint.model = "flexible".',
    ),
    (
        JOINT + 'model = "flexible"\n' + BOTH_ENCODERS + '[method]\nminimiser = "nelder-mead"',
        'method.minimiser is for DIDIM, but the method is IDIM: leave it out, or use method.name = "didim".',
    ),
    (
        JOINT + CHANNELS + '[method]\nname = "idim"\nestimator = "iv"',
        'controller is missing, but method.estimator = "iv" simulates the loop: add it, or use another.',
    ),
    (
        JOINT + CHANNELS + CASCADE + '[method]\nname = "didim"\ndrift = "force"',
        'method.drift is for IDIM, but the method is DIDIM: leave it out, or use method.name = "idim".',
    ),
    (
        JOINT + CHANNELS + "[method]\nperiod = 0.005",
        "method.period is 0.005, but there are no harmonics; add harmonics = 1, or leave it out.",
    ),
    (
        FLEXIBLE + "[method]\nfrequency = -30",
        "method.frequency is -30; expected a positive number: correct it, or leave it out.",
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS,
        "method.name is missing, and no method can be chosen: DIDIM lacks controller, IDIM of a flexible joint lacks "
        'record.channels.load_position; add what one of them lacks, or set joint.model = "rigid".',
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS.replace("motor_", "load_"),
        "method.name is missing, and no method can be chosen: DIDIM lacks controller, IDIM of a flexible joint lacks "
        "record.channels.motor_position; add what one of them lacks.",
    ),
    (
        FLEXIBLE + '[method]\nname = "idim"',
        "record.channels.load_position is missing, but IDIM of a flexible joint needs it: add it, or use "
        'method.name = "didim", which needs only torque, reference and controller.',
    ),
    (
        JOINT + 'model = "flexible"\n' + CHANNELS + '[method]\nname = "didim"',
        'controller is missing, but DIDIM needs it: add it, or use method.name = "idim", which needs only torque, '
        "motor_position and load_position.",
    ),
    # parameters
    (
        SMALLEST + "[parameters]\ninertai = 3",
        "parameters.inertai is not known for a rigid joint with symmetric friction; expected one of inertia, "
        "viscous, coulomb, offset: did you mean inertia?",
    ),
    (
        SMALLEST + "[parameters]\nstiffness = 3",
        "parameters.stiffness is not known for a rigid joint with symmetric friction; expected one of inertia, "
        'viscous, coulomb, offset: leave it out, or set joint.model = "flexible".',
    ),
    (
        SMALLEST + "[parameters]\nviscous_forwards = 3",
        "parameters.viscous_forwards is not known for a rigid joint with symmetric friction; expected one of "
        'inertia, viscous, coulomb, offset: leave it out, or set joint.friction = "asymmetric".',
    ),
    # gravity
    (
        SMALLEST + '[gravity]\nload = "link"\n[parameters]\ngravity_cos = 3',
        "gravity: A prismatic joint does not turn its load, so nothing of its gravity follows a cosine or a sine; use "
        'load = "constant", or a revolute joint.',
    ),
    (
        SMALLEST.replace(JOINT, JOINT + 'friction = "asymmetric"\n') + '[gravity]\nload = "constant"',
        "gravity: A constant load cannot be distinguished from asymmetric friction: it adds to the Coulomb force "
        "forwards and takes as much from it backwards; use symmetric friction, or leave gravity out.",
    ),
    (
        LINK + "angle = 0",
        "gravity.angle is 0; expected a number other than 0: correct it, or leave it out.",
    ),
    (
        LINK.replace("link", "arm"),
        'gravity.load is "arm"; expected "constant" or "link": choose one of them.',
    ),
    (
        SMALLEST + '[gravity]\nload = "constant"\n[parameters]\noffset = { start = 3 }',
        "parameters.offset cannot be identified beside a constant load: torque and motor position only know the sum of "
        "both; give it a value, or leave [gravity] out.",
    ),
    # ripple
    (
        SMALLEST + "[ripple]\nharmonics = 2",
        "ripple.period is missing; expected a positive number (of the first harmonic, such as the pitch of a screw "
        "or of the motor's slots, on the side that is reported; idim finds one by its own harmonics [m or rad]): add "
        "it.",
    ),
    (
        SMALLEST + '[ripple]\nperiod = 0.005\nside = "load"',
        'ripple: A rigid joint has no load side of its own; use side = "motor".',
    ),
    (
        SMALLEST.replace(JOINT, JOINT + 'friction = "stribeck"\n') + "[ripple]\nperiod = 0.005",
        "ripple: Stribeck friction, which is in pieces, is not simulated beside a ripple; use symmetric friction, or "
        "leave the ripple out.",
    ),
    (
        SMALLEST.replace(JOINT, JOINT + 'model = "flexible"\nspring = "backlash"\n') + "[ripple]\nperiod = 0.005",
        "ripple: A backlash spring, which is in pieces, is not simulated beside a ripple; use a linear spring, or "
        "leave the ripple out.",
    ),
    (
        SMALLEST + "[parameters]\nharmonic_1_sine = { start = 3 }",
        "parameters.harmonic_1_sine is not known for a rigid joint with symmetric friction; expected one of inertia, "
        "viscous, coulomb, offset: leave it out, or set ripple.period.",
    ),
    (
        SMALLEST + "[parameters]\ngravity_cos = { start = 3 }",
        "parameters.gravity_cos is not known for a rigid joint with symmetric friction; expected one of inertia, "
        'viscous, coulomb, offset: leave it out, or set gravity.load = "link".',
    ),
    (
        LINK + "counterbalance = { cos = 2 }\n[parameters]\ncounterbalance_cos = { start = 3 }",
        "parameters.counterbalance_cos is known, and not identified; give it a value, or change it in "
        "gravity.counterbalance.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = -3",
        "parameters.inertia is -3; expected more than 0: correct it, or its bounds.",
    ),
    (
        SMALLEST + '[parameters]\ninertia = "3"',
        'parameters.inertia is "3"; expected a number, or a table: write it without quotes.',
    ),
    (
        SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }",
        "parameters.inertia.start is 3; expected 4 or more: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { start = 9, lower = 4, upper = 5 }",
        "parameters.offset.start is 9; expected a number from 4 to 5: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { start = 9, upper = 5 }",
        "parameters.offset.start is 9; expected 5 or less: correct it, or its bounds.",
    ),
    (
        SMALLEST + "[parameters]\nviscous = { upper = -5 }",
        "parameters.viscous.upper is -5; expected more than 0: raise it.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = { upper = 0 }",
        "parameters.inertia.upper is 0; expected more than 0: raise it.",
    ),
    (
        SMALLEST + "[parameters]\ninertia = { lower = inf }",
        "parameters.inertia.lower is inf; expected less than inf: lower it.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { lower = nan }",
        "parameters.offset.lower is nan; expected a number, inf or -inf: correct it, or leave it out.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { lower = 3, upper = 1 }",
        "parameters.offset.lower is 3; expected less than upper = 1: exchange them.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { free = false }",
        "parameters.offset.value is missing; a parameter that is not free needs the value that it keeps: add it.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { value = 3, free = true }",
        "parameters.offset.free is true beside value = 3, which would fix it; write start = 3.",
    ),
    (
        SMALLEST + "[parameters]\noffset = { value = 3, start = 3 }",
        "parameters.offset.start stands beside value; keep value to fix the parameter, or start to identify it.",
    ),
    (
        SMALLEST.replace('"prismatic"', '"prismatic"\nfriction = "asymmetric"')
        + "[parameters]\noffset = { free = true }",
        "parameters.offset cannot be identified beside asymmetric friction: a constant adds to the Coulomb force "
        "forwards and takes as much from it backwards, so the two cannot be distinguished; give it a value, or set "
        'joint.friction = "symmetric".',
    ),
    # TOML
    (
        "[joint]\nkind = prismatic",
        "Line 2, column 8 is not TOML (invalid value); expected [tables] and lines of key = value, text in "
        '"quotes": correct that line.',
    ),
    (
        '[joint]\nkind = "prismatic',
        "Line 2, column 18 is not TOML (unterminated string); expected [tables] and lines of key = value, text in"
        ' "quotes": correct that line.',
    ),
    (
        "x = " + "9" * 5000,
        "The joint file holds a number of thousands of digits; correct it.",
    ),
    (
        "x = " + "[" * 20000,
        "The joint file nests lists or tables too deeply; no key of it needs that.",
    ),
]


@pytest.mark.parametrize(("text", "sentence"), FAULTS, ids=[sentence[:50] for _, sentence in FAULTS])
def test_a_fault_is_one_sentence(text: str, sentence: str) -> None:
    assert faults(text) == (sentence,)


@pytest.mark.parametrize(
    ("wrong", "meant"),
    [
        (
            SMALLEST + "INTEGRAL_GAIN = 3.0",
            "controller.INTEGRAL_GAIN is not a known key; .* did you mean integral_gain",
        ),
        (SMALLEST + "[Method]", "Method is not a known key; .* did you mean method"),
        (SMALLEST + "[drive]\nratedTorque = 3.0", "drive.ratedTorque is not a known key; .* did you mean rated_torque"),
        (SMALLEST + "torque_filters = [{ D = 1.0, numerator = [1.0] }]", "0.D is not a known key; .*: leave it out."),
        (SMALLEST.replace('"cascade"', '"PID"'), 'law is "PID"; .* did you mean "pid"'),
    ],
)
def test_the_case_of_a_word_does_not_hide_which_was_meant(wrong: str, meant: str) -> None:
    (said,) = faults(wrong)
    assert re.search(meant, said)


def test_all_faults_come_at_once() -> None:
    found = faults(
        """
        [joint]
        kind = "prismatic"
        friktion = "symmetric"
        [record]
        delimiter = "ab"
        sample_time = -1
        [record.channels]
        torque = { column = "i", gain = -2.0 }
        reference = { column = "r", unit = "deg" }
        motor_position = 3
        [controller]
        position_gain = "a"
        [filtering]
        preset = "published"
        borders = [1, 2]
        [method]
        name = "idim"
        iterations = 5
        [parameters]
        inertia = { lower = 2, upper = 1 }
        viscous = "a"
        """
    )
    expected = [
        "joint.friktion",
        "record.delimiter:",
        "record.sample_time",
        "record.channels.torque.gain",
        "record.channels.reference.unit",
        "record.channels.motor_position is",
        "controller.law",
        "filtering.borders",
        "method.iterations",
        "parameters.inertia.lower",
        "parameters.viscous",
    ]
    assert len(found) == len(expected)
    for key in expected:
        assert sum(sentence.startswith(key) for sentence in found) == 1, key


def test_a_joint_with_other_faults_still_has_its_model() -> None:
    found = faults(FLEXIBLE.replace('"flexible"', '"flexible"\nfriktion = "symmetric"') + "[method]\niterations = 3")
    assert [sentence.split()[0] for sentence in found] == ["joint.friktion", "method.iterations"]
    for unknown in (FLEXIBLE.replace("flexible", "flexibel"), SMALLEST.replace(JOINT, "joint = 3\n")):
        (sentence,) = faults(f"{unknown}[method]\niterations = 3\nminimiser = 'nelder-mead'")
        assert sentence.startswith("joint")


def test_a_file_that_is_not_there_or_no_text(tmp_path: Path) -> None:
    with pytest.raises(JointFileError, match=r"none\.toml cannot be opened \(no such file .*\); check the path"):
        load(tmp_path / "none.toml")
    (tmp_path / "joint.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(JointFileError, match=r"is not text in UTF-8 \(byte 8\); save it as UTF-8"):
        load(tmp_path / "joint.toml")
    (tmp_path / "marked.toml").write_text(SMALLEST, encoding="utf-8-sig")
    assert load(tmp_path / "marked.toml") == loads(SMALLEST)


@pytest.mark.parametrize(
    ("right", "wrong", "sentence"),
    [
        ("[controller]", "[contoller]", "contoller is not a known key;"),
        ("[joint]", "[jont]", "jont is not a known key;"),
        ("[record.channels]", "[record.chanels]", "record.chanels is not a known key;"),
    ],
)
def test_nothing_is_missed_that_is_there_with_its_name_misspelt(right: str, wrong: str, sentence: str) -> None:
    text = SMALLEST.replace("motor_position", "load_position")
    assert right in text
    (found,) = faults(text.replace(right, wrong))
    assert found.startswith(sentence)
    assert found.endswith(f"did you mean {right.strip('[]').rpartition('.')[2]}?")


def test_a_unit_that_is_nearly_known_is_told_the_one_that_may_be_meant() -> None:
    (found,) = faults(SMALLEST + 'delay = "1 Ms"\n')
    assert found == 'controller.delay is "1 Ms"; "Ms" is no unit that is known; write "ms" if that is meant.'


@pytest.mark.parametrize(
    ("text", "place", "code"),
    [
        (SMALLEST + "position_gian = 3", ("controller", "position_gian"), "unknown"),
        (SMALLEST + "limit = 0", ("controller", "limit"), "value"),
        (SMALLEST.replace("position_gain = 100.0\n", ""), ("controller", "position_gain"), "missing"),
        (SMALLEST + "torque_filters = [{ D = 1.0 }]", ("controller", "torque_filters", 0, "D"), "unknown"),
        (SMALLEST.replace('"r"', '"r", unit = "deg"'), ("record", "channels", "reference", "unit"), "unit"),
        (JOINT + CHANNELS + '[method]\nname = "didim"', ("controller",), "missing"),
        (SMALLEST + "[parameters]\ninertia = { start = 3, lower = 4 }", ("parameters", "inertia", "start"), ""),
        (SMALLEST + '[[records]]\nfile = "a.csv"\nown = ["mass"]', ("records", 0, "own"), "unknown"),
    ],
)
def test_a_fault_has_its_place_and_code_as_data(text: str, place: tuple[int | str, ...], code: str) -> None:
    (fault,) = faults(text)
    assert fault.place == place
    assert fault.code == (code or "contradiction")
    assert fault.startswith(dot_path(place))
