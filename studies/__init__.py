"""Monte-Carlo studies behind numbers in the documentation; not part of the installed package."""
