"""Contacts: association of detections into objects on the sea floor, and their export to files people and programs read."""
