"""The web page: the program in a browser, on this machine only."""
