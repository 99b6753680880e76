"""Campaigns: the same verb for many joints and many runs, on one machine and on a cluster."""
