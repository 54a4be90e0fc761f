"""Training-free detection: highlight and shadow against the local sea floor, in units of its own speckle."""
