"""Classification of contacts by the highlight and shadow that a solid of known shape would have."""
