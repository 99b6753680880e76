"""What every room may use: errors a user can meet, units, progress."""
