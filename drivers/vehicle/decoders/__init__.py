"""From what a vehicle sends to records: pure, and once per byte, whether or not anyone talks to it."""
