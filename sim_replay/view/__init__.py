"""Show a mission in a browser of this computer: waterfall, map and contacts to look at, judge and measure."""
