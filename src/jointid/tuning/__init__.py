"""Tuning: margins of an estimate's loop over its interval, gains, a notch and feed-forward."""
