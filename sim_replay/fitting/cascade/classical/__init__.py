"""Train the source paper's classical classifier (section 4.4.1): features of image chips and a linear discriminant."""
