"""Transforms (tf2) of a recording: one pair of frames as poses, chains of them, and all of them as a tree."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from flexmap_tasks.errors import InputError
from flexmap_tasks.formats import mcap_ros
from flexmap_tasks.formats.mcap_columns import columns, guard
from flexmap_tasks.formats.mcap_records import Recording
from flexmap_tasks.formats.mcap_ros import Decoded, frame_name
from flexmap_tasks.formats.mcap_topics import Topic, choose_topic, topics_of
from flexmap_tasks.formats.track_rows import Rows, fill_stamps, printable
from flexmap_tasks.formats.transform_tree import Link, TransformTree, along, moments
from flexmap_tasks.geometry.se3 import Poses

TRANSFORM_KINDS = {"tf2_msgs/TFMessage": ("cdr",)}
STATIC_TOPIC = "tf_static"

LISTED_PAIRS = 30
"""An error lists at most this many frame pairs."""

Pairs = Mapping[tuple[str, str], Decoded]


def read_transforms(recording: Recording, topic: str | None, parent: str, child: str) -> Rows:
    """Poses of `child` in `parent`, from the topic that has the pair or along a chain of transforms.

    /tf and /tf_static are looked through alike; a chain such as map -> odom -> base_link is read at the times
    of its busiest link. Raises InputError where no chain leads from one frame to the other.
    """
    pair = (frame_name(parent), frame_name(child))
    found = [(t, _pairs(recording, t)) for t in _topics(recording, topic)]
    direct = [(t, pairs[pair]) for t, pairs in found if pair in pairs]
    if len(direct) > 1:
        names = ", ".join(t.label for t, _ in direct)
        rule = f"several topics hold {parent} -> {child}: name one of {names} as `slam.topic`"
        raise InputError(recording.name, rule)
    if direct:
        chosen, rows = direct[0]
        place = f"topic {chosen.label} message"
        return Rows(rows.values, rows.stamp_ns, lambda row: f"{place} {rows.message[row] + 1}", chosen.kind)
    steps = _tree(found).chain(*pair)
    if not steps:
        shown = "; ".join(f"{t.label} has {_listed(pairs)}" for t, pairs in found)
        raise InputError(recording.name, f"no transform {parent} -> {child}; {shown}")
    stamps = moments(steps)
    poses = along(steps, stamps)
    known = np.isfinite(poses.xyz_m).all(axis=1)
    if not known.any():
        rule = f"the transforms from {parent} to {child} have no time in common"
        raise InputError(recording.name, f"{rule}: record them together")
    values = np.column_stack([poses.xyz_m, poses.quaternion])[known]
    return Rows(
        values,
        stamps[known],
        lambda row: f"transform {row + 1} from {parent} to {child}",
        "tf2_msgs/TFMessage",
    )


def transform_tree(recording: Recording) -> TransformTree:
    """All frames of the recording; an empty tree where it has no transforms."""
    every = [t for t in topics_of(recording) if t.kind in TRANSFORM_KINDS and t.encoding == "cdr" and t.count]
    return _tree([(t, _pairs(recording, t)) for t in every])


def listed_pairs(recording: Recording, topic: Topic) -> str:
    """The frame pairs of a topic, for the choice a user must make."""
    try:
        return _listed(_pairs(recording, topic))
    except InputError as error:
        return f"unreadable ({error.rule})"


def _topics(recording: Recording, topic: str | None) -> list[Topic]:
    if topic is not None:
        return [choose_topic(recording, TRANSFORM_KINDS, topic, "transforms", "slam.topic")]
    every = [t for t in topics_of(recording) if t.kind in TRANSFORM_KINDS and t.encoding == "cdr" and t.count]
    # With no topic at all the choice has the message that lists what there is.
    return every or [choose_topic(recording, TRANSFORM_KINDS, None, "transforms", "slam.topic")]


def _pairs(recording: Recording, topic: Topic) -> Pairs:
    messages = columns(recording, topic)
    pairs = guard(recording, topic, lambda: mcap_ros.transforms(messages.data, messages.begin, messages.end))
    return {
        pair: Decoded(
            rows.values, fill_stamps(rows.stamp_ns, messages.log_time_ns[rows.message]), rows.message
        )
        for pair, rows in pairs.items()
    }


def _tree(found: list[tuple[Topic, Pairs]]) -> TransformTree:
    """Links of all topics; a pair that several have is taken from all of them."""
    parts: dict[tuple[str, str], list[tuple[bool, Decoded]]] = {}
    for topic, pairs in found:
        for pair, rows in pairs.items():
            parts.setdefault(pair, []).append((topic.name.endswith(STATIC_TOPIC), rows))
    links = []
    for pair, several in parts.items():
        values = np.concatenate([rows.values for _, rows in several])
        stamps = np.concatenate([rows.stamp_ns for _, rows in several])
        link = Link.of(stamps, Poses(values[:, :3], values[:, 3:]), static=any(s for s, _ in several))
        if link is not None:
            links.append((pair, link))
    return TransformTree(links)


def _listed(pairs: Pairs) -> str:
    names = [printable(f"{parent} -> {child}") for parent, child in sorted(pairs)]
    more = f" and {len(names) - LISTED_PAIRS} more" if len(names) > LISTED_PAIRS else ""
    return ", ".join(names[:LISTED_PAIRS]) + more
