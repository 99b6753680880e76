"""The paper: its digital twin."""
