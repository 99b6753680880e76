"""Identification of the controller from reference, motor position and torque."""
