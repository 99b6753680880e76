"""What was written stays whole when a program is killed or its disk is full; JOINTID_ATTACKS=200 tries more."""
