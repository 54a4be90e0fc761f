"""Simulate vehicle controllers by their makers' manuals, and fly what they accept."""
