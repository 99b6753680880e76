"""Identification problems: filtered residual and Jacobian of a record and model."""
