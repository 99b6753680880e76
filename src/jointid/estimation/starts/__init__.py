"""Starts of searches: starts for rigid and flexible joints, nonlinear laws and robots."""
