"""Classify the kind of sea floor below."""
