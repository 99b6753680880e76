"""Records and the signals in them."""
