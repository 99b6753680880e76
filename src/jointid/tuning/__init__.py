"""What to do with an estimate: margins of its loop over the interval, gains, a notch and feed-forward."""
