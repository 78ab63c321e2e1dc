"""People's decisions, by the stage that carries them out."""

from __future__ import annotations

from flexmap_tasks.engine.stage import stage
from flexmap_tasks.formats.review_decisions_csv import read_review_decisions
from flexmap_tasks.model.review import Decided
from flexmap_tasks.model.source import Source


@stage("decided")
def ingest_review_decisions(source: Source) -> Decided:
    """The decisions of the file in its order, sorted by kind: a decision on a value leaves matching as it is."""
    told = read_review_decisions(source)
    return Decided(*map(told.of_kind, Decided.KINDS))
