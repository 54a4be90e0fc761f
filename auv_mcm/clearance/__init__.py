"""Map how well the sea floor was searched, and estimate what the search left behind."""
