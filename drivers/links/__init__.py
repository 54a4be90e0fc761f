"""The wires: serial ports, CAN buses, UDP and TCP, all of one shape, that outlive unplugged cables and devices without power."""
