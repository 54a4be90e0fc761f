"""Stand in for the sea: a simulator, log readers, replay, scoring, reports, benches."""
