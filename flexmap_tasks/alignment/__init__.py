"""Track, map and cloud come into the map frame."""
