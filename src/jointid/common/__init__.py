"""Common to all folders: errors a user can meet, units, settings, messages, documents."""
