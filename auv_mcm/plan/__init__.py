"""Plans proposed to the vehicle: shortest turns and straight legs past contacts worth a second look."""
