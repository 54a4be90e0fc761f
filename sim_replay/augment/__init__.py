"""Embed targets in recorded side-scan logs, from the relief, reflectivity and beam pattern of the recorded sea
floor."""
