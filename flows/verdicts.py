"""What a run that was not published means for the person who started it."""

from __future__ import annotations

from flexmap_tasks.engine.gate import Verdict
from flexmap_tasks.errors import HeldError, NotPublishedError, RejectedError


def not_published(verdict: Verdict | None) -> NotPublishedError | None:
    """The error of a candidate that the gate stopped; None when it was published, or from before there was a gate."""
    if verdict is None or verdict.state == "published":
        return None
    reasons = "; ".join(verdict.reasons)
    if verdict.state == "rejected":
        return RejectedError(f"{verdict.map}: release {verdict.release} is rejected: {reasons}")
    return HeldError(
        f"{verdict.map}: release {verdict.release} is {verdict.state}: {reasons}; "
        f"when it is good: flexmap release publish {verdict.map} {verdict.release}"
    )
