"""The frames of a recording and how they hang together (tf2: REP 105, geometry2).

A frame has one parent at a time; a chain of transforms leads from any frame to any other of the same tree. At a
time each link is interpolated between its neighbours in time; nothing is guessed beyond its first and last one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from flexmap_tasks.geometry.se3 import Poses, compose, interpolate, inverse
from flexmap_tasks.model.arrays import Ints
from flexmap_tasks.model.tracks import rows_in_time_order

UNIT_TOLERANCE = 0.02
"""Quaternions further from unit length than this are no rotations."""


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """One frame in its parent over time.

    stamp_ns : (n,) ascending; poses : of the child in the parent; static : holds for ever
    """

    stamp_ns: Ints
    poses: Poses
    static: bool

    @classmethod
    def of(cls, stamp_ns: Ints, poses: Poses, *, static: bool) -> Link | None:
        """In time order; None when no transform is a finite rotation. What never changes is static."""
        norm = np.linalg.norm(poses.quaternion, axis=1)
        good = np.isfinite(poses.xyz_m).all(axis=1) & (np.abs(norm - 1.0) < UNIT_TOLERANCE)
        rows = np.flatnonzero(good)
        rows = rows[rows_in_time_order(stamp_ns[rows])]
        if not len(rows):
            return None
        kept = Poses(poses.xyz_m[rows], poses.quaternion[rows] / norm[rows, None])
        still = all((column == column[0]).all() for column in kept)
        return cls(stamp_ns[rows], kept, static or bool(still))

    def at(self, at_ns: Ints) -> Poses:
        """At the given times; NaN where the link does not reach."""
        if not self.static:
            return interpolate(at_ns, self.stamp_ns, self.poses)
        return Poses(*(np.repeat(column[:1], len(at_ns), axis=0) for column in self.poses))


Step = tuple[Link, bool]
"""A link, and whether it is walked from parent to child."""


class TransformTree:
    """All links of a recording by (parent, child)."""

    def __init__(self, links: Iterable[tuple[tuple[str, str], Link]]) -> None:
        self.links = dict(links)
        self._near: dict[str, list[tuple[str, Step]]] = {}
        for (parent, child), link in sorted(self.links.items(), key=lambda item: item[0]):
            self._near.setdefault(parent, []).append((child, (link, True)))
            self._near.setdefault(child, []).append((parent, (link, False)))

    def chain(self, start: str, goal: str) -> list[Step] | None:
        """The links from one frame to another, the fewest; None when none lead there."""
        came: dict[str, tuple[str, Step] | None] = {start: None}
        waiting = deque([start])
        while waiting and goal not in came:
            frame = waiting.popleft()
            for near, step in self._near.get(frame, ()):
                if near not in came:
                    came[near] = (frame, step)
                    waiting.append(near)
        if goal not in came:
            return None
        steps: list[Step] = []
        back = came[goal]
        while back is not None:
            steps.append(back[1])
            back = came[back[0]]
        return steps[::-1]

    def names(self) -> list[str]:
        """All frames."""
        return sorted(self._near)


def along(steps: list[Step], at_ns: Ints) -> Poses:
    """Poses of the last frame of a chain in its first one; NaN where a link does not reach."""
    n = len(at_ns)
    out = Poses(np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))
    for link, downwards in steps:
        here = link.at(at_ns)
        out = compose(out, here if downwards else inverse(here))
    return out


def moments(steps: list[Step]) -> Ints:
    """The stamps of the link that moves most often: when the chain as a whole is known best."""
    moving = [link for link, _ in steps if not link.static]
    busiest = max(moving or [link for link, _ in steps], key=lambda link: len(link.stamp_ns))
    return busiest.stamp_ns
