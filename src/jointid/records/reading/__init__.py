"""Read a record: whole from a file, or in chunks."""
