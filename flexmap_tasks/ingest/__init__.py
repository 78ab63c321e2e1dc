"""Files become values: one stage per input."""
