"""Common to all rooms: errors a user can meet, units, settings, documents, progress."""
