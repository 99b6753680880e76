"""One joint from several records: what they share, whether they agree, and the verb `identify_together`."""
