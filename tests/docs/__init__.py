"""The documentation: its programs and commands run, and its pages say what the program says."""
