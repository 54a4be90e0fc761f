"""Run the real service between fake devices that fail on request, and judge its behaviour."""
