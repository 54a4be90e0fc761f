"""Find how fine a sonar has to resolve to find mines, to distinguish them from rocks, and to name them."""
