"""Whole missions in one process: the vehicle flies what the payload plans, through a simulated world, until an area is cleared."""
