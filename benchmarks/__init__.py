"""The benchmarks: the same closed loops by this package and by its peers; see README.md."""
