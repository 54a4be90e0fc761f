"""Train the detector's cascade on simulated and augmented sea floor: samples, boosting, validation."""
