"""Run the far ends of wires as programs: ports, adapters and servers that fail on request, alike for the same seed."""
