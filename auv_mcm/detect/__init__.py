"""Detect without training: highlight and shadow against the local sea floor, in units of its own speckle."""
