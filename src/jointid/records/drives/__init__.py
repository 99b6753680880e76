"""Drives and their traces: counts, per mille, the names each maker uses; a profile (TOML) for each kind."""
