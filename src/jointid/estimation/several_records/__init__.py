"""One joint from several records: what they share, and whether they agree."""
