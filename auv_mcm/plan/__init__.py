"""Propose plans to the vehicle: shortest turns and straight legs past contacts that need a second view."""
