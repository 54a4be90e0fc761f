"""Sessions: every byte that came in or went out of each port, with the times of both clocks, recorded and read back."""
