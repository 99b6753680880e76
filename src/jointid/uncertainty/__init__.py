"""What is known of an estimate, against a criterion alone: intervals, what repeats, what a record tells."""
