"""What OpenStreetMap knows goes into the lanelets."""
