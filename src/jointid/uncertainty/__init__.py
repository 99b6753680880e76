"""Uncertainty of an estimate: covariance, profiles, tests, identifiability."""
