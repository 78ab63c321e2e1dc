"""The same town some time later: what mappers changed in between."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.model.arrays import Floats, Ints
from flexmap_tasks.simulate.chance import stream
from flexmap_tasks.simulate.osm_tags import FALLIBLE, false_value
from flexmap_tasks.simulate.osm_ways import Link
from flexmap_tasks.simulate.world import World

BEND_M = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """A way before it is written; chain : the pieces it is made of (none for what is no real road)."""

    id: int
    nodes: Ints
    tags: dict[str, str]
    chain: list[Link]
    version: int = 1
    present: bool = True


@dataclass(frozen=True, slots=True)
class Change:
    """One change; kind : "tag", "geometry", "gone" or "new"; key, old, new : of a tag, else ""."""

    way_id: int
    kind: str
    key: str = ""
    old: str = ""
    new: str = ""


def some_time_later(world: World, ways: list[Way], xy: Floats) -> tuple[list[Way], Floats, list[Change]]:
    """Ways and places of nodes at the second date; `ways` that are not present yet appear."""
    rng, share = stream(world.seed, "osm_later"), world.osm.changed_share
    used = np.bincount(np.concatenate([np.unique(w.nodes) for w in ways]), minlength=len(xy))
    out, moved, changes = [], xy.copy(), list[Change]()
    for way in ways:
        gone, bent, tagged = rng.uniform(size=3) < share
        pick = int(rng.integers(0, 1000))
        if not way.present:
            out.append(replace(way, present=True))
            changes.append(Change(way.id, "new"))
        elif not way.chain:
            out.append(way)
        elif gone and way.tags["highway"] in ("residential", "service", "living_street"):
            out.append(replace(way, present=False))
            changes.append(Change(way.id, "gone"))
        elif bent and _bend(moved, way.nodes, used, 1.0 if pick % 2 else -1.0):
            out.append(way)  # its nodes get a new version, as in OpenStreetMap
            changes.append(Change(way.id, "geometry"))
        elif tagged and (key := _first_key(way.tags, pick)):
            new = f"Neue {way.tags[key]}" if key == "name" else false_value(key, way.tags[key], pick)
            out.append(replace(way, version=2, tags=way.tags | {key: new}))
            changes.append(Change(way.id, "tag", key, way.tags[key], new))
        else:
            out.append(way)
    return out, moved, changes


def _first_key(tags: dict[str, str], pick: int) -> str:
    keys = [k for k in FALLIBLE if k in tags]
    return keys[pick % len(keys)] if keys else ""


def _bend(xy: Floats, nodes: Ints, used: Ints, side: float) -> bool:
    """Move the nodes that only this way uses sideways; False when it has none."""
    own = np.flatnonzero(used[nodes] == 1)
    own = own[(own > 0) & (own < len(nodes) - 1)]
    if not len(own):
        return False
    way = xy[nodes[-1]] - xy[nodes[0]]
    length = max(float(np.hypot(*way)), 1e-9)
    share = (xy[nodes[own]] - xy[nodes[0]]) @ way / length**2
    normal = np.array([-way[1], way[0]]) / length
    xy[nodes[own]] += side * BEND_M * np.sin(np.pi * np.clip(share, 0.0, 1.0))[:, None] * normal
    return True
