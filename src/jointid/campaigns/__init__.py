"""Campaigns: identification of many joints and runs, locally or on a cluster."""
