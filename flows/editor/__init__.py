"""Control points picked by hand, in a browser, on this machine."""
