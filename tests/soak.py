"""The long version of the kill test: 500 kills, or as many as are asked for.

    python -m tests.soak [KILLS] [SECONDS]

Every third kill is followed by a run that must end with the undisturbed bytes. Ends early after SECONDS.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "engine"))

from test_engine_disturbed import kill_runs, time_of_a_run
from work import files_of, run_toy

from flexmap_tasks.store.store import Store

KILLS = 500
BATCH = 30


def main(kills: int = KILLS, seconds: float = 1800.0) -> int:
    """Exit code 0 when every run healed."""
    folder = Path(tempfile.mkdtemp(prefix="flexmap-soak-"))
    try:
        numbers = folder / "numbers.txt"
        numbers.write_text("1\n2\n3\n4\n")
        expected = files_of(run_toy(Store.open(folder / "calm"), numbers).folder)
        longest_s = min(time_of_a_run(folder / f"timed{i}", numbers) for i in range(5))
        began = time.monotonic()
        done = early = 0
        while done < kills and time.monotonic() - began < seconds:
            early += kill_runs(folder / "killed", numbers, expected, BATCH, done, longest_s)
            done += BATCH
            print(f"{done} kills, {early} of them before the run was done; every run after them was right")
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return 0 if done >= kills else 1


if __name__ == "__main__":
    sys.exit(main(*(int(argument) for argument in sys.argv[1:])))
