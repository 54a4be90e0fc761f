"""Run whole missions in one process: the vehicle flies the payload's plans through a simulated world until an area is
cleared.
"""
