"""Global matching: lanes as paths on the graph of roads."""
