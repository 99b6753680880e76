"""What was identified, in the languages of other tools; one file for each language."""
