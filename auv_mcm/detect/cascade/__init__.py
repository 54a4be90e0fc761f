"""Detect by a cascade of boosted comparisons of box means, trained on simulated and augmented targets."""
