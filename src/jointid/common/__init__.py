"""Common to all folders: errors, units, settings, messages, documents."""
