"""The estimate: parameters with their uncertainty, verdicts and printed table."""
