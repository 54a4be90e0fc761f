"""Solids in closed form, and the search over their parameters: what kernels and the simulator share with classification."""
