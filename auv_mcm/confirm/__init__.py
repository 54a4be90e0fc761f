"""Is there an object? Segmentation of the region around a detection into highlight, shadow and background, and contours of both."""
