"""Which road of OpenStreetMap every metre of every lane belongs to, and what either map lacks."""
