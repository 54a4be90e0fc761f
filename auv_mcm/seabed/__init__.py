"""What kind of sea floor passes below."""
