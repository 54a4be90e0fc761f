"""Side-scan sonars: what they send as frames, and what they are told as bytes."""
