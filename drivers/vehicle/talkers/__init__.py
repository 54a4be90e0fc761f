"""Encode the payload's messages to a vehicle, and interpret the records of the vehicle's decoder."""
