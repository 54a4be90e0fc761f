"""Measure accuracy and cost of the stages side by side."""
