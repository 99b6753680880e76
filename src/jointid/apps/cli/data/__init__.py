"""`jointid data`: files of records, without identifying anything."""
