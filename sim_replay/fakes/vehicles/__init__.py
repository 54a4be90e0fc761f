"""Vehicle controllers as their makers describe them, and the fake vehicle that flies what they accept."""
