"""What people decided about values that were put up for review."""

from __future__ import annotations

from dataclasses import dataclass

from flexmap_tasks.model.arrays import Ints, Strings


@dataclass(frozen=True, slots=True, eq=False)
class ReviewDecisions:
    """One row per decision. It holds while lanelet, key, the map's value, OSM's value and the way stay the same.

    lanelet_id, way_id : (n,) int64
    key, old, new : (n,) str, the attribute, what the map said and what OSM offered when it was decided
    accept : (n,) str, "accept" or "reject"; value : (n,) str, what to write instead of `new`, "" for `new` itself
    note : (n,) str, who decided, when and why
    """

    lanelet_id: Ints
    way_id: Ints
    key: Strings
    old: Strings
    new: Strings
    accept: Strings
    value: Strings
    note: Strings

    def __len__(self) -> int:
        return len(self.lanelet_id)
