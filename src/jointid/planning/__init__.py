"""Planning of tests: predicted accuracy, and the best test within the axis limits."""
