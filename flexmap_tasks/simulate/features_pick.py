"""Where a feature of the town fits."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import lines
from flexmap_tasks.simulate.roads import Draft


def shuffled(items: Iterable[int], rng: np.random.Generator) -> list[int]:
    """The items in an order of chance that does not depend on the order they come in."""
    rows = np.array(sorted(items), dtype=np.int64)
    return [int(v) for v in rng.permutation(rows)]


def plain_roads(draft: Draft, least_m: float, two_way: bool = True) -> list[int]:
    """Ordinary roads of some length on the ground."""
    return [
        i
        for i in draft.living()
        if (r := draft.get(i)).length_m >= least_m
        and r.role == "" and r.level == 0 and (not two_way or r.backward > 0)
    ]  # fmt: skip


def direction_out(draft: Draft, arm: tuple[int, bool]) -> Floats:
    """Unit direction in which a road leaves the junction of this arm."""
    xy = draft.get(arm[0]).xyz
    xy = xy[::-1] if arm[1] else xy
    step = lines.at(xy, np.array([min(12.0, lines.along(xy)[-1])]))[0] - xy[0]
    return np.asarray(step / np.hypot(*step))
