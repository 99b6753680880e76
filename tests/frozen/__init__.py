"""What the package answers, frozen: `python -m tests.frozen` says what has changed."""
