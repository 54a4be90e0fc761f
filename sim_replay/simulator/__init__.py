"""Simulate a sea: sea floor, objects, sonar and vehicle, with the truth about all of them."""
