"""Ways out of pieces: OSM joins what has equal tags and runs on straight, or does not bother."""

from __future__ import annotations

import numpy as np

from flexmap_tasks.model.arrays import Floats
from flexmap_tasks.simulate.osm_survey import Piece

Link = tuple[int, bool]
"""(piece, against its line)."""
End = tuple[int, bool]
"""(piece, its last node)."""
NARROW_TURN_RAD = 0.7


def join_pieces(
    pieces: list[Piece], allowed: list[int], share: float, rng: np.random.Generator
) -> list[list[Link]]:
    """Chains of pieces, each one way; `share` of the joints that fit are joined.

    No way visits a node twice, and one-way pieces are never turned.
    """
    ends: dict[int, list[End]] = {}
    for k in allowed:
        ends.setdefault(int(pieces[k].nodes[0]), []).append((k, False))
        ends.setdefault(int(pieces[k].nodes[-1]), []).append((k, True))
    joined: dict[End, End] = {}
    for node in sorted(ends):
        wanted = rng.random() < share
        pair = _straight_pair(pieces, ends[node])
        if wanted and pair:
            joined[pair[0]], joined[pair[1]] = pair[1], pair[0]
    return _walked(pieces, allowed, joined)


def _straight_pair(pieces: list[Piece], ends: list[End]) -> tuple[End, End] | None:
    """The two ends at a node that run straightest into each other and may be one way."""
    best, found = NARROW_TURN_RAD, None
    for n, a in enumerate(ends):
        for b in ends[n + 1 :]:
            first, second = pieces[a[0]], pieces[b[0]]
            turned = "oneway" in first.tags and a[1] == b[1]
            special = first.twin >= 0 or second.twin >= 0 or "junction" in first.tags
            if a[0] == b[0] or first.tags != second.tags or turned or special:
                continue
            turn = float(np.arccos(np.clip(-_outward(first, a[1]) @ _outward(second, b[1]), -1.0, 1.0)))
            if turn < best:
                best, found = turn, (a, b)
    return found


def _outward(piece: Piece, at_end: bool) -> Floats:
    xy = piece.xy[::-1] if at_end else piece.xy
    step = xy[1] - xy[0]
    return np.asarray(step / max(float(np.hypot(*step)), 1e-9))


def _walked(pieces: list[Piece], allowed: list[int], joined: dict[End, End]) -> list[list[Link]]:
    """Chains in the order of their first piece."""
    chains: list[list[Link]] = []
    seen: set[int] = set()
    waiting = list(reversed(allowed))
    while waiting:
        k = waiting.pop()
        if k in seen:
            continue
        waiting.append(k)  # a ring is cut where it would close: the piece it began with may be left
        chain = [_first_link(k, joined, seen)]
        nodes = set(pieces[chain[0][0]].nodes.tolist())
        seen.add(chain[0][0])
        while (after := joined.get((chain[-1][0], not chain[-1][1]))) is not None:
            fresh = pieces[after[0]].nodes.tolist()
            fresh = fresh[-2::-1] if after[1] else fresh[1:]
            if after[0] in seen or nodes & set(fresh):
                break
            nodes |= set(fresh)
            seen.add(after[0])
            chain.append(after)
        if "oneway" in pieces[chain[0][0]].tags and chain[0][1]:
            chain = [(n, not flipped) for n, flipped in reversed(chain)]
        chains.append(chain)
    return chains


def _first_link(piece: int, joined: dict[End, End], seen: set[int]) -> Link:
    """Walk back from a piece to where its chain begins, not into pieces that have their way."""
    here: Link = (piece, False)
    trail = {piece} | seen
    while (before := joined.get(here)) is not None and before[0] not in trail:
        here = (before[0], not before[1])
        trail.add(before[0])
    return here
