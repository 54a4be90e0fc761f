"""Connect the hardware: links, sonars, navigation units and vehicles, each behind one interface."""
