"""Motions that tell a robot's parameters, within what its joints may do."""
