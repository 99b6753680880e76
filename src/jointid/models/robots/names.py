"""The names and symbols of a robot's parameters, the same for every method.

A number of a motor or a spring is named by its joint and what it is, "elbow.viscous". A base parameter is a sum, and is
named by the symbol of its first inertial parameter, "Izz1". The sum of a rotor and its link about an axis that is none
of the link's frame is "elbow.inertia".
"""

from __future__ import annotations

_SYMBOLS = {
    "inertia": "ZZ",
    "rotor_inertia": "Ia",
    "viscous": "Fv",
    "viscous_forwards": "Fv+",
    "viscous_backwards": "Fv-",
    "coulomb": "Fc",
    "stribeck_force": "FS",
    "friction_per_torque": "mu",
    "offset": "offset",
    "stiffness": "K",
    "damping": "D",
    "link_viscous": "FvL",
    "link_viscous_forwards": "FvL+",
    "link_viscous_backwards": "FvL-",
    "link_coulomb": "FcL",
    "link_stribeck_force": "FSL",
}


def symbol_of(quantity: str, joint: int) -> str:
    """Return the symbol of a joint's number with the joint's place from 1: "Fc2", "Fv2+"; of others its name."""
    symbol = _SYMBOLS.get(quantity, quantity)
    word = symbol.rstrip("+-")
    return f"{word}{joint + 1}{symbol[len(word) :]}"


def name_of(quantity: str, joint: str) -> str:
    """Return the name of a number of the joint with this name: "elbow.viscous"."""
    return f"{joint}.{quantity}"


def inertial_symbol(symbol: str, link: int) -> str:
    """Return the symbol of a link's inertial parameter with the link's place from 1: "Izz1"."""
    return f"{symbol}{link + 1}"
