"""Judge how the payload is from what it measures of itself, and show that to people, monitors and the vehicle."""
