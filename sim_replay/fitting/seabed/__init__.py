"""Learning what kinds of sea floor look like, from simulated missions that know."""
