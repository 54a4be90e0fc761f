"""Associate detections into objects on the sea floor, and export them to files that people and programs read."""
