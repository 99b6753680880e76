"""Identification problems: a record and a model in, filtered residual and Jacobian out."""
