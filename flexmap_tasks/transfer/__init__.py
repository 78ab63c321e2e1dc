"""What OpenStreetMap knows goes into the lanelets, without harm."""
