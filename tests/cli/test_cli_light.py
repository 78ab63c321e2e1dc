"""A run that has nothing to do must not load what it does not need: half a second is all it may take."""

from __future__ import annotations

import subprocess
import sys

HEAVY = ("numpy", "pyarrow", "prefect", "shapely", "pyproj", "obstore", "httpx", "flexmap_tasks.pipeline",
         "flexmap_tasks.engine.fingerprint")  # fmt: skip


def test_the_command_itself_is_light() -> None:
    code = f"import sys, flows.cli; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
