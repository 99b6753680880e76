"""Numerical minimisation, for any criterion: parameters in, residual and Jacobian out."""
