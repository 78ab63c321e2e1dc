"""Lanelets cut where a value that lands changes along them."""
