"""Uncertainty of an estimate, from arrays and a problem alone: covariance, profiles, residual tests, identifiability."""
