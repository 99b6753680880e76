"""The paper: its tables, what follows from them, its digital twin, and its reproduction."""
