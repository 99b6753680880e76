"""Check a record: finite numbers, plausible scale and limits; and warn of what limits its use."""
