"""Recorded pictures of sea floor as tiles, their outlines and calls: what tests/real/test_images_real.py judges."""
