"""The hardware ends: links, sonars, navigation units and vehicles, each behind one seam."""
