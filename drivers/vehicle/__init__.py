"""Communicate with the vehicle's own controller: decode its messages, report to it, command it while it grants
control."""
