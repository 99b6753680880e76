"""Tests planned before they are run: what each would tell, and which one tells most."""
