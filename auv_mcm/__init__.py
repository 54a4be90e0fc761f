"""Payload service of a mine-hunting AUV: side-scan pings and navigation in, contacts and waypoints out."""

__version__ = "0.1.0"
