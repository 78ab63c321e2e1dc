"""How alike a candidate and its reference polyline are (Zhang and Meng 2005), for all candidates at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from flexmap_tasks.config import MatchParams
from flexmap_tasks.geometry.lanelets import offsets
from flexmap_tasks.matching.buffers.candidates import RoadChains
from flexmap_tasks.matching.buffers.references import ReferenceLines
from flexmap_tasks.model.arrays import Bools, Floats, Ints

CUT_SPACING_M = 1.0
"""Candidates begin and end at least this far apart, however densely a road is drawn."""
AREA_STRIPS = 24
"""Strips over which the area between two polylines is summed."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Parts of road chains, with the terms and the score of each.

    reference : (n,) int64; first, last : (n,) int64, rows in the chains, both included
    angle_deg : between the chords; length_m, chord_m : differences of length and of chord length
    area_m : enclosed area over the reference's length; score : (n,) float64 in 0..1
    """

    reference: Ints
    first: Ints
    last: Ints
    angle_deg: Floats
    length_m: Floats
    chord_m: Floats
    area_m: Floats
    score: Floats

    def take(self, rows: Ints | Bools) -> Candidates:
        """The chosen candidates."""
        return Candidates(
            self.reference[rows], self.first[rows], self.last[rows], self.angle_deg[rows],
            self.length_m[rows], self.chord_m[rows], self.area_m[rows], self.score[rows],
        )  # fmt: skip


def candidates_of(chains: RoadChains, references: ReferenceLines, params: MatchParams) -> Candidates:
    """All parts of the chains that pass the exclusion limits, scored.

    Score = sum of weight * (1 - term / limit) over the four terms, divided by the sum of the weights.
    """
    reference, first, last = _parts(chains, references, params.length_max_m)
    start, end = chains.a_m[first], chains.b_m[last]
    ref_a = references.segments.a_m[references.offset[:-1]][reference]
    ref_b = references.segments.b_m[references.offset[1:] - 1][reference]
    length = chains.along_m[last + 1] - chains.along_m[first]
    angle = _angle_deg(ref_b - ref_a, end - start)
    d_length = np.abs(length - references.length_m[reference])
    d_chord = np.abs(np.hypot(*(end - start).T) - np.hypot(*(ref_b - ref_a).T))
    kept = (angle < params.angle_max_deg) & (d_length < params.length_max_m) & (d_chord < params.chord_max_m)
    reference, first, last = reference[kept], first[kept], last[kept]
    angle, d_length, d_chord = angle[kept], d_length[kept], d_chord[kept]
    area = _area_m(chains, references, reference, first, last)
    weights = (params.weight_angle, params.weight_length, params.weight_chord, params.weight_area)
    limits = (params.angle_max_deg, params.length_max_m, params.chord_max_m, params.area_max_m)
    terms = (angle, d_length, d_chord, area)
    total = sum(weights) or 1.0
    score = sum(w * (1.0 - t / limit) for w, t, limit in zip(weights, terms, limits, strict=True)) / total
    found = Candidates(reference, first, last, angle, d_length, d_chord, area, np.asarray(score))
    return found.take(area < params.area_max_m)


def _parts(chains: RoadChains, references: ReferenceLines, length_max_m: float) -> tuple[Ints, Ints, Ints]:
    """Parts of chains whose length is within the limit of the reference's: (reference, first, last)."""
    size = np.diff(chains.offset)
    chain = np.repeat(np.arange(len(size)), size)
    place = chains.along_m[:-1] - chains.along_m[chains.offset[:-1]][chain]
    bucket = np.floor(place / CUT_SPACING_M)
    n = len(chain)
    new_chain = np.append(True, chain[1:] != chain[:-1])[:n]
    begins = np.append(True, (bucket[1:] != bucket[:-1]) | new_chain[1:])[:n]
    ends = np.append(begins[1:], True)[:n]
    first, last = np.flatnonzero(begins), np.flatnonzero(ends)
    length = references.length_m[chains.reference[chain[first]]]
    end_m, start_m = chains.along_m[last + 1], chains.along_m[first]
    group = chain[first]
    # `end_m` grows over all chains, so one search serves all; the chain's own range bounds it.
    lo = np.searchsorted(end_m, start_m + length - length_max_m, side="right")
    hi = np.searchsorted(end_m, start_m + length + length_max_m, side="left")
    lo = np.maximum(lo, np.arange(len(first)))
    hi = np.minimum(hi, np.searchsorted(group, group, side="right"))
    count = np.maximum(hi - lo, 0)
    of = np.repeat(np.arange(len(first)), count)
    to = lo[of] + np.arange(len(of)) - offsets(count)[of]
    return chains.reference[group[of]], first[of], last[to]


def _angle_deg(a: Floats, b: Floats) -> Floats:
    """Angle between vectors, degrees 0 to 180; 0 where both have no length (two rings), 180 where one has."""
    cross = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    angle = np.degrees(np.arctan2(cross, np.einsum("ij,ij->i", a, b)))
    none_a, none_b = np.hypot(*a.T) < 1e-6, np.hypot(*b.T) < 1e-6
    result: Floats = np.where(none_a & none_b, 0.0, np.where(none_a | none_b, 180.0, angle))
    return result


def _area_m(
    chains: RoadChains, references: ReferenceLines, reference: Ints, first: Ints, last: Ints
) -> Floats:
    """Area between candidate and reference over the reference's length, crossings not cancelling out."""
    share = np.linspace(0.0, 1.0, AREA_STRIPS + 1)
    segments = references.segments
    ref_along = np.append(0.0, np.cumsum(segments.length_m))
    p = _at(ref_along, segments.a_m, segments.b_m,
            references.offset[reference], references.offset[reference + 1] - 1, share)  # fmt: skip
    q = _at(chains.along_m, chains.a_m, chains.b_m, first, last, share)
    d1, d2 = q[:, 1:] - p[:, :-1], q[:, :-1] - p[:, 1:]
    area = np.abs(d1[..., 0] * d2[..., 1] - d1[..., 1] * d2[..., 0]).sum(axis=1) / 2
    result: Floats = area / references.length_m[reference]
    return result


def _at(along_m: Floats, a_m: Floats, b_m: Floats, first: Ints, last: Ints, share: Floats) -> Floats:
    """(n, k, 2) points at the given shares of the length of segments first..last."""
    place = along_m[first][:, None] + share * (along_m[last + 1] - along_m[first])[:, None]
    row = np.clip(np.searchsorted(along_m, place, side="right") - 1, first[:, None], last[:, None])
    t = np.clip((place - along_m[row]) / (along_m[row + 1] - along_m[row]), 0.0, 1.0)[..., None]
    points: Floats = a_m[row] + t * (b_m[row] - a_m[row])
    return points
