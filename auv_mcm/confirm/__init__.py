"""Confirm a detection: segment the region around it into highlight, shadow and background, and find contours of
both."""
