"""Uncertainty of an estimate, from arrays and a problem alone: covariance, profiles, tests, identifiability."""
