"""The vehicle's own controller: what it says, what it is told, and when it may be told anything."""
