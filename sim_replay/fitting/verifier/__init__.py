"""Fit a convolutional verifier to chips of the waterfall, to be compared with the odds of measurements."""
