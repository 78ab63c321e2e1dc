"""FlexMap: georeference HD maps and carry OpenStreetMap knowledge into them."""

import time

LOADED_NS = time.time_ns()
"""When this process began to load the package: code that was edited later may be older in memory than on disk."""
