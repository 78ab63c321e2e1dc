"""The road network of a town: junctions, and roads as directed lines between them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate import lines

TagChange = tuple[float, str, str]
"""(share of the road's length, key, value): from there to the end the tag has this value."""


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """One road from junction `start` to junction `end`.

    xyz : (k, 3) metres in the town's frame, in the middle of its driving lanes
    highway, name, maxspeed, surface : as OpenStreetMap would say; "" where it would say nothing
    forward, backward : driving lanes along and against the line; backward 0 is a one-way road
    role : "" or what the road is part of: roundabout, dual, island, slip, frontage, ramp, parking, cul_de_sac
    pair : number that the two carriageways of a dual carriageway or island share, -1 without
    level : 0 on the ground, 1 on a bridge
    changes : where tags change between the ends
    bus, bicycle : the outermost lane per direction is a bus lane; a bicycle lane lies beside it
    """

    start: int
    end: int
    xyz: Floats
    highway: str
    forward: int = 1
    backward: int = 1
    lane_width_m: float = 3.25
    name: str = ""
    maxspeed: int = 50
    surface: str = "asphalt"
    role: str = ""
    pair: int = -1
    level: int = 0
    changes: tuple[TagChange, ...] = ()
    bus: bool = False
    bicycle: bool = False

    @property
    def length_m(self) -> float:
        """Length in the plane."""
        return float(lines.along(self.xyz)[-1])

    @property
    def width_m(self) -> float:
        """Width of all driving lanes."""
        return (self.forward + self.backward) * self.lane_width_m

    def sections(self) -> list[tuple[float, float, dict[str, str]]]:
        """(from, to, tags) in metres along the road, each with equal tags."""
        tags = {
            "name": self.name,
            "maxspeed": str(self.maxspeed) if self.maxspeed else "",
            "surface": self.surface,
        }
        length, out, begin = self.length_m, [], 0.0
        for share, key, value in sorted(self.changes):
            if share * length > begin:
                out.append((begin, share * length, dict(tags)))
                begin = share * length
            tags[key] = value
        return [*out, (begin, length, dict(tags))]


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """All junctions and roads; side is +1 where traffic keeps right, -1 where it keeps left.

    node_xyz : (n, 3); signal_nodes, stop_nodes, crosswalk_nodes : junctions with that equipment
    """

    node_xyz: Floats
    roads: tuple[Road, ...]
    side: int
    signal_nodes: frozenset[int] = frozenset()
    stop_nodes: frozenset[int] = frozenset()
    crosswalk_nodes: frozenset[int] = frozenset()

    def arms(self) -> list[list[tuple[int, bool]]]:
        """Per junction its (road, at the road's end) in the order of the roads."""
        out: list[list[tuple[int, bool]]] = [[] for _ in self.node_xyz]
        for i, road in enumerate(self.roads):
            out[road.start].append((i, False))
            out[road.end].append((i, True))
        return out


class Draft:
    """A network on the drawing board, in the plane; a road that is taken away leaves its number unused.

    Everything is drawn for traffic that keeps right; `finished` mirrors it for the other side.
    """

    def __init__(self) -> None:
        self.nodes: list[Floats] = []
        self._roads: dict[int, Road] = {}
        self._arms: dict[int, set[tuple[int, bool]]] = {}
        self._next = 0
        self._pairs = 0

    def node(self, xy: Floats) -> int:
        """Add a junction."""
        self.nodes.append(np.asarray(xy, dtype=np.float64)[:2])
        return len(self.nodes) - 1

    def road(self, road: Road) -> int:
        """Add a road; its line is bent to end exactly in its junctions."""
        xy = road.xyz[:, :2].copy()
        xy[0], xy[-1] = self.nodes[road.start], self.nodes[road.end]
        self._next += 1
        self._put(self._next - 1, replace(road, xyz=xy))
        return self._next - 1

    def _put(self, i: int, road: Road) -> None:
        self.remove(i)
        self._roads[i] = road
        self._arms.setdefault(road.start, set()).add((i, False))
        self._arms.setdefault(road.end, set()).add((i, True))

    def remove(self, i: int) -> None:
        """Take road i away, if it is there."""
        road = self._roads.pop(i, None)
        if road is not None:
            self._arms[road.start].discard((i, False))
            self._arms[road.end].discard((i, True))

    def get(self, i: int) -> Road:
        """Road i, which must be there."""
        return self._roads[i]

    def living(self) -> list[int]:
        """Numbers of the roads that are there."""
        return sorted(self._roads)

    def change(self, i: int, **values: object) -> None:
        """Give road i other properties."""
        self._put(i, replace(self._roads[i], **values))  # type: ignore[arg-type]

    def arms(self, node: int) -> list[tuple[int, bool]]:
        """(road, at its end) of the roads at a junction."""
        return sorted(self._arms.get(node, ()))

    def split(self, i: int, s_m: float) -> tuple[int, int]:
        """Cut road i at s_m, before any tag change: the new junction and the number of the far part."""
        road = self._roads[i]
        if road.changes:
            raise ValueError("tags change on a road that is to be split: split first")
        node = self.node(lines.at(road.xyz, np.array([s_m]))[0])
        first, second = lines.cut(road.xyz, 0.0, s_m), lines.cut(road.xyz, s_m, road.length_m)
        self._put(i, replace(road, end=node, xyz=first))
        return node, self.road(replace(road, start=node, xyz=second))

    def new_pair(self) -> int:
        """A number for two carriageways that belong together."""
        self._pairs += 1
        return self._pairs - 1

    def finished(self, side: int) -> tuple[Floats, list[Road]]:
        """Junctions in use (m, 2) and their roads, mirrored where traffic keeps left."""
        roads = [self._roads[i] for i in self.living()]
        used = sorted({n for r in roads for n in (r.start, r.end)})
        place = {n: k for k, n in enumerate(used)}
        mirror = np.array([side, 1.0])
        xy = np.array([self.nodes[n] for n in used]) * mirror
        return xy, [
            replace(r, start=place[r.start], end=place[r.end], xyz=r.xyz[:, :2] * mirror) for r in roads
        ]
