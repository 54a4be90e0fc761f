"""The far ends of wires, as programs: ports, adapters and servers that go wrong on demand, the same way for the same seed."""
