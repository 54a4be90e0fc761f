"""Decode a vehicle's bytes to records: pure, and once per byte, whether or not anyone talks to it."""
