"""Connect serial ports, CAN buses, UDP and TCP behind one interface that outlives unplugged cables."""
