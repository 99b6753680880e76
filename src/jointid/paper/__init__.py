"""The paper: tables, recomputation, digital twin and reproduction."""
