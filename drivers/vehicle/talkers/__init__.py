"""What the payload says to a vehicle, and what it makes of the records that the vehicle's decoder hands on."""
