"""Hardware in the loop without the hardware: the real service between fake devices that fail on demand, and a verdict on what it did."""
