"""The compiled kernels; one call tree per file, as the cache on disk sees edits in its own file only."""
