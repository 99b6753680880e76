"""Modelica: the joint's equations with their friction as it was identified, in one model that needs no library.

A mass at rest stays there while its Coulomb friction holds what pushes it; the push does not depend on accelerations,
so one whole number for each mass says all: 1 forwards, -1 backwards, 0 held. It changes where the velocity changes its
sign, and where the push of a mass at rest exceeds the friction. Where friction winds up over a displacement no mass
rests: what it is wound up to is a state more, from -1 to 1.
"""

from __future__ import annotations

from collections.abc import Iterator

from jointid.estimation.result.parts import EstimatedParameter
from jointid.models.friction import (
    DIRECTIONS,
    PARTS,
    DriftingFriction,
    LoadDependentFriction,
    PreslidingFriction,
    StribeckFriction,
    WoundLoadDependentFriction,
)
from jointid.models.springs import CubicSpring, ElasticLoad, HystereticSpring
from jointid.output.export.joint_model import JointModel, effects_left_out, identifier, interval, number, remarks

_RESERVED = (
    "algorithm", "and", "annotation", "block", "break", "class", "connect", "connector", "constant", "constrainedby",
    "der", "discrete", "each", "else", "elseif", "elsewhen", "encapsulated", "end", "enumeration", "equation",
    "expandable", "extends", "external", "false", "final", "flow", "for", "function", "if", "import", "impure", "in",
    "initial", "inner", "input", "loop", "model", "not", "operator", "or", "outer", "output", "package", "parameter",
    "partial", "protected", "public", "pure", "record", "redeclare", "replaceable", "return", "stream", "then", "time",
    "true", "type", "when", "while", "within",
)  # fmt: skip
_FUNCTIONS = {"constant": "1", "cos": "cos({})", "sin": "sin({})", "rate": "{}"}


def modelica(model: JointModel) -> tuple[str, tuple[str, ...]]:
    """Return a joint as Modelica 3, a model with an input for the torque, and what is not in it.

    Raises:
        MethodError: a value is refused, or no joint can have it.
    """
    name, lost = identifier(model.name, _RESERVED), effects_left_out(model)
    prefixes = {mass: f"{mass}_" if model.flexible else "" for mass in model.masses}
    _ = model.stiffness  # which refuses what no joint has
    in_pieces = {p.name for p in model.spring.parameters} if model.spring is not None and model.pieces else set()
    lines = [
        f'model {name} "{model.kind} {model.joint.model} joint, identified"',
        *(f"  // {line}" for line in remarks(model, lost)),
        *(_declare(p) for p in model.parameters if p.name not in in_pieces),
    ]
    if model.gravity is not None:
        angle = number(model.gravity.angle)
        lines.append(f'  parameter Real gravity_angle = {angle} "rad of the link per unit of the position";')
    if model.wave is not None:
        wave = number(model.wave)
        lines.append(f'  parameter Real ripple_wave = {wave} "rad of the first harmonic per unit of the position";')
    side = "" if model.side is None else f", on the {model.side} side"
    if model.gear != 1.0:
        side = f", seen on the load side: {number(model.gear)} times its own"
    lines.append(f'  input Real torque(unit="{_unit(model.torque_unit)}") "of the motor{side}";')
    for mass in prefixes:
        lines += _variables(model, mass)
    lines += _spring_variables(model)
    if not _winds_up(model):
        lines.append("initial equation")
    for mass, prefix in prefixes.items() if not _winds_up(model) else ():
        lines.append(f"  {mass}_direction = if {mass}_velocity > 0 then 1 else if {mass}_velocity < 0 then -1")
        lines.append(f"    else {_release(model, mass, prefix)};")
    lines += ["equation", *_spring_equations(model)]
    for mass, prefix in prefixes.items():
        lines += _equations(model, mass, prefix)
    return "\n".join([*lines, f"end {name};", ""]), lost


def _declare(p: EstimatedParameter) -> str:
    assert p.value is not None
    return f'  parameter Real {p.name}(unit="{_unit(p.unit)}") = {number(p.value)} "{p.symbol}: {interval(p)}";'


def _unit(unit: str) -> str:
    """Return a unit as Modelica writes it: factors joined by points, and one stroke."""
    return unit.replace(" ", ".")


def _variables(model: JointModel, mass: str) -> Iterator[str]:
    position, force = model.position_unit, _unit(model.torque_unit)
    yield f'  output Real {mass}_position(unit="{position}", start=0, fixed=true);'
    yield f'  output Real {mass}_velocity(unit="{position}/s", start=0, fixed=true);'
    yield f'  Real {mass}_push(unit="{force}") "what moves the {mass}, but for its friction";'
    if _winds_up(model):
        yield f'  Real {mass}_wound(start=0, fixed=true) "share of its Coulomb friction that is wound up";'
    else:
        yield f'  Integer {mass}_direction "1 forwards, -1 backwards, 0 held by its friction";'


def _winds_up(model: JointModel) -> bool:
    """True if friction winds up after a reversal."""
    return isinstance(model.joint.friction, PreslidingFriction)


def _equations(model: JointModel, mass: str, prefix: str) -> Iterator[str]:
    position, velocity, push, direction = (
        f"{mass}_{word}" for word in ("position", "velocity", "push", "direction")
    )  # fmt: skip
    (viscous, coulomb), (viscous_back, coulomb_back) = _friction(model, prefix)
    (holds, holds_back), slow = _holds(model, prefix), _slow(model, prefix, velocity)
    less, more = (f" - {slow}", f" + {slow}") if slow else ("", "")
    swings = mass == "load" and isinstance(model.spring, ElasticLoad)
    inertia = f"(1 - swinging_share) * {prefix}inertia" if swings else f"{prefix}inertia"
    yield f"  der({position}) = {velocity};"
    yield f"  {push} = {_push(model, mass)};"
    if _winds_up(model):
        wound, distance = f"{mass}_wound", f"{prefix}presliding_distance"
        yield f"  {inertia} * der({velocity}) = {push} - {viscous} * {velocity} - {coulomb} * {wound};"
        yield f"  der({wound}) = ({velocity} - abs({velocity}) * {wound}) / {distance};"
        return
    yield f"  {inertia} * der({velocity}) ="
    yield f"    if {direction} > 0 then {push} - {viscous} * {velocity} - {coulomb}{less}"
    yield f"    else if {direction} < 0 then {push} - {viscous_back} * {velocity} + {coulomb_back}{more}"
    yield "    else 0;"
    stops = [f"pre({direction}) > 0 and {velocity} < 0", f"pre({direction}) < 0 and {velocity} > 0"]
    starts = [
        f"pre({direction}) == 0 and {push} > {holds}", f"pre({direction}) == 0 and {push} < -{holds_back}"
    ]  # fmt: skip
    yield "  when {"
    yield ",\n".join(f"    {condition}" for condition in (*stops, *starts))
    yield "  } then"
    yield f"    {direction} = {_release(model, mass, prefix)};"
    yield f"    reinit({velocity}, 0);"
    yield "  end when;"


def _release(model: JointModel, mass: str, prefix: str) -> str:
    """Return the direction in which a mass at rest starts."""
    holds, holds_back = _holds(model, prefix)
    return f"if {mass}_push > {holds} then 1 else if {mass}_push < -{holds_back} then -1 else 0"


def _holds(model: JointModel, prefix: str) -> tuple[str, str]:
    """Return up to which push friction holds a mass at rest, forwards and backwards."""
    (_, coulomb), (_, coulomb_back) = _friction(model, prefix)
    if not isinstance(model.joint.friction, StribeckFriction):
        return coulomb, coulomb_back
    return f"({coulomb} + {prefix}stribeck_force)", f"({coulomb_back} + {prefix}stribeck_force)"


def _slow(model: JointModel, prefix: str, velocity: str) -> str:
    """Return by how much friction is another at low speed; nothing of a law that has no such part."""
    if not isinstance(model.joint.friction, StribeckFriction):
        return ""
    return f"{prefix}stribeck_force * exp(-({velocity} / {prefix}stribeck_speed)^2)"


def _friction(model: JointModel, prefix: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return the names of viscous and Coulomb friction, forwards and backwards; "0" where the law has none."""
    law = model.joint.friction
    named = [[law.coefficient_name(part, direction) for part in PARTS] for direction in DIRECTIONS]
    forwards, backwards = (tuple("0" if name is None else f"{prefix}{name}" for name in names) for names in named)
    viscous, coulomb = "{}", "{}"
    if isinstance(law, DriftingFriction):
        viscous, coulomb = (f"({{}} + {prefix}{part}_drift * time)" for part in PARTS)
    if isinstance(law, LoadDependentFriction | WoundLoadDependentFriction) and prefix != "motor_":
        coulomb = f"({{}} + {prefix}friction_per_torque * abs({'spring' if model.flexible else 'torque'}))"
    (one, other), (back, behind) = forwards, backwards
    return (viscous.format(one), coulomb.format(other)), (viscous.format(back), coulomb.format(behind))


_OF_A_PIECE = ("begin", "torque", "stiffness", "damping")
"""What a piece of a spring has, in the order of `Piece`: where it begins, with which torque, and how it goes on."""


def _spring_variables(model: JointModel) -> Iterator[str]:
    """Yield the parameters of the pieces of a spring, and its torque if it is a variable."""
    position, force = model.position_unit, _unit(model.torque_unit)
    units = (position, force, f"{force}/{position}", f"{force}.s/{position}")
    for i, piece in enumerate(model.pieces, 1):
        for word, value, unit in zip(_OF_A_PIECE, piece, units, strict=True):
            yield f'  parameter Real spring_{i}_{word}(unit="{unit}") = {number(value)};'
    if _names_spring(model):
        yield f'  Real windup(unit="{position}") "of the load against the motor";'
        yield f'  Real spring(unit="{force}") "between motor and load";'
    if isinstance(model.spring, HystereticSpring):
        yield f'  Real slider(unit="{force}", start=0, fixed=true) "beside the spring";'
    if isinstance(model.spring, ElasticLoad):
        yield f'  output Real swinging_position(unit="{position}", start=0, fixed=true) "of what swings on the load";'
        yield f'  Real swinging_velocity(unit="{position}/s", start=0, fixed=true);'
        yield f'  Real pull(unit="{force}") "of what swings on the load";'


def _names_spring(model: JointModel) -> bool:
    """True if the torque of the spring is a variable of its own."""
    return bool(model.pieces) or (model.flexible and model.joint.stepped)


def _spring_equations(model: JointModel) -> Iterator[str]:
    """Yield the torque of a spring, of one in pieces the last one first; nothing where it has no name."""
    pieces, slip = model.pieces, "(load_velocity - motor_velocity)"
    if not _names_spring(model):
        return
    yield "  windup = load_position - motor_position;"
    if not pieces:
        more = " + cubic_stiffness * windup * windup * windup" if isinstance(model.spring, CubicSpring) else ""
        more += " + slider" if isinstance(model.spring, HystereticSpring) else ""
        yield f"  spring = stiffness * windup{more} + damping * {slip};"
    if isinstance(model.spring, HystereticSpring):
        yield f"  der(slider) = hysteresis_stiffness * ({slip} - abs({slip}) * slider / hysteresis_torque);"
    if isinstance(model.spring, ElasticLoad):
        swing, swung = "(swinging_position - load_position)", "(swinging_velocity - load_velocity)"
        yield "  der(swinging_position) = swinging_velocity;"
        yield f"  pull = swinging_stiffness * {swing} + swinging_damping * {swung};"
        yield "  swinging_share * load_inertia * der(swinging_velocity) = -pull;"
    if not pieces:
        return
    yield "  spring ="
    for i in range(len(pieces), 0, -1):
        begin, torque, stiffness, damping = (f"spring_{i}_{word}" for word in _OF_A_PIECE)
        elastic, damped = f"{stiffness} * windup", f"{damping} * {slip}"
        if i == 1:
            yield f"    {elastic} + {damped};"
            continue
        beside = f"({torque} - {stiffness} * {begin})"
        yield f"    if windup > {begin} then {beside} + {elastic} + {damped} else"
        yield f"    if windup < -{begin} then -{beside} + {elastic} + {damped} else"


def _push(model: JointModel, mass: str) -> str:
    spring = "stiffness * (load_position - motor_position) + damping * (load_velocity - motor_velocity)"
    spring = "spring" if _names_spring(model) else spring
    push = "torque - offset" if mass == "motor" else f"-({spring})"
    if mass == "motor" and model.flexible:
        push = f"{push} + {spring}"
    if mass == "load" and isinstance(model.spring, ElasticLoad):
        push += " + pull"
    push += "".join(_ripple_terms(model, mass))
    carries = mass == "load" or not model.flexible
    return push + "".join(_gravity_terms(model, f"{mass}_position")) if carries else push


def _ripple_terms(model: JointModel, mass: str) -> Iterator[str]:
    """Yield the terms of the ripple in the force on a mass."""
    ripple = model.joint.ripple
    if ripple is None or ripple.side != mass:
        return
    for i, p in enumerate(ripple.parameters):
        yield f" - {p.name} * {'sin' if i % 2 else 'cos'}({i // 2 + 1} * ripple_wave * {mass}_position)"


def _gravity_terms(model: JointModel, position: str) -> Iterator[str]:
    """Yield the terms of gravity and a counterbalance in the force on a mass."""
    for p in model.parameters:
        of, _, term = p.name.partition("_")
        if of in ("gravity", "counterbalance"):
            argument = position if term == "rate" else f"gravity_angle * {position}"
            yield f" {'-' if of == 'gravity' else '+'} {p.name} * {_FUNCTIONS[term].format(argument)}"
