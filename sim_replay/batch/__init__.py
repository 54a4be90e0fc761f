"""Replay whole archives: a mission per log, then the objects that several missions saw."""
