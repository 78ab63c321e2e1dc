"""`make bench`: every speed as a ratio to a peer measured in the same run, or as growth over sizes.

`python -m tests.bench` runs all subjects, `python -m tests.bench NAME ...` the named ones. A subject is a module of
this folder with a function `run()`; heavy imports stay inside it.
"""

from __future__ import annotations

import sys
from importlib import import_module

from tests.bench.measure import DATA, console

SUBJECTS = (
    "alignment",
    "untimed",
    "garching",
    "conflation",
    "nothing_changed",
    "fleet",
    "warp",
    "tiles",
    "browser",
    "cloud",
    "recordings",
)


def main(wanted: list[str]) -> int:
    """Run the named subjects, or all; 1 where the real inputs are absent, 2 for an unknown name."""
    if unknown := [name for name in wanted if name not in SUBJECTS]:
        console.print(f"no benchmark is called {unknown[0]}; there are: {', '.join(SUBJECTS)}")
        return 2
    if not DATA.is_dir():
        console.print("the real inputs are absent (../shared/data): nothing to measure")
        return 1
    for name in wanted or SUBJECTS:
        import_module(f"tests.bench.{name}").run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
