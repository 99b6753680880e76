"""When each sample was taken: uniform sampling, the clock column, resampling, and how often a value was refreshed."""
