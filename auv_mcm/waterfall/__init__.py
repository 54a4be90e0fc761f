"""Turn pings into metric waterfall tiles: quality control, bottom tracking, ground range, radiometry, along-track
grid."""
