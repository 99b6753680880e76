"""Equations: friction, gravity, joints, controllers. No data, no solver, no state."""
