"""How good it is, in figures with units."""
