"""The map frame becomes global coordinates and an Autoware bundle."""
