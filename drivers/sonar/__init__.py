"""Decode side-scan sonars to frames, and encode their commands."""
