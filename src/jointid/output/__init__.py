"""Results as documents, figures, JSON and models for other programs; it only reads results."""
