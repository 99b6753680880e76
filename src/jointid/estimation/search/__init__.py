"""The search for the parameters: descents, starts and multistart."""
