"""Model solids in closed form, and search their parameters: shared by kernels, simulator and classification."""
