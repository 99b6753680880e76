"""The compiled kernels; the cache on disk sees edits of every file in this folder."""
