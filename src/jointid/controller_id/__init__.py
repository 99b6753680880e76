"""The controller, learned from one record that shows reference, motor position and torque."""
