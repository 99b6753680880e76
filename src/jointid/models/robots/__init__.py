"""Robots of several joints: a tree of links, its dynamics, and its inertial parameters."""
