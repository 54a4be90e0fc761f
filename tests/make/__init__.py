"""Generators of recordings for tests."""
