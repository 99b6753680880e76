"""Equations: parameters, friction, joints, controllers. No data, no solver, no state."""
