"""Recorded sea floor as a scene of relief, reflectivity and beam pattern, and images of it with targets that were never there."""
