"""Where a search begins: starts for rigid and flexible joints, nonlinear laws and robots."""
