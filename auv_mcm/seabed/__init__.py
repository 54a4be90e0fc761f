"""Classify the seabed."""
