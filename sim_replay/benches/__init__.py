"""Benches: what things cost and how true they are, error beside time."""
