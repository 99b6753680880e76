"""Equations: friction, gravity, joints, disturbances, controllers. No data, no solver, no state."""
