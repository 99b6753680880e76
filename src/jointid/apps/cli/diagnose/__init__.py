"""`jointid diagnose`: what an estimate is worth, one question a command."""
