"""Training of the detector's cascade on simulated and augmented sea floor: what it learns from, how it learns, how it is judged."""
