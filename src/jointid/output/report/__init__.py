"""The report: its sections, tables and text, as HTML or Markdown."""
