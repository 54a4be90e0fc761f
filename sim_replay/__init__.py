"""Everything that stands in for the sea: log readers, synthetic missions, benches, reports."""
