"""The page in the browser: the same verbs for someone who has never seen a terminal, on this machine only."""
