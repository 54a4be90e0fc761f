"""Measure how well the payload finds mines: missions full of targets, the outcome of each look, and the tables fitted
to that.
"""
