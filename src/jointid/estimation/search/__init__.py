"""The search for the parameters: its history, starts and multistart."""
