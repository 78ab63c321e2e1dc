"""The editors of one map behind one server."""

from __future__ import annotations

from flexmap_tasks.config import FlexMapConfig
from flexmap_tasks.engine.local import OnDone
from flexmap_tasks.errors import ConfigError
from flexmap_tasks.store.store import Store
from flows.editor.review_session import ReviewSession
from flows.editor.server import EditServer
from flows.editor.session import EditSession


def edit_server(config: FlexMapConfig, store: Store, port: int = 0, done: OnDone | None = None) -> EditServer:
    """A server that listens already, with the pages whose files the configuration names.

    done : what the review needs is computed first, and this is told of every stage as it ends

    Raises ConfigError where it names none of them, or where the port is taken.
    """
    points_file, review_file = config.alignment.control_points_file, config.conflation.review_file
    reviewed = review_file is not None and config.lanelet_map is not None and config.osm is not None
    places = (("points",) if points_file else ()) + (("review",) if reviewed else ())
    if not places:
        rule = (
            "name the file that the editor saves to: alignment.control_points_file for control points, "
            "conflation.review_file (with lanelet_map and osm) for decisions; neither has to exist yet"
        )
        raise ConfigError("configuration", rule)
    points = EditSession(config, store, points_file, places) if points_file else None
    review = ReviewSession(config, store, review_file, places) if reviewed and review_file else None
    if review is not None and done is not None:
        review.prepare(done)
    try:
        return EditServer(points, review, port)
    except (OSError, OverflowError) as error:
        raise ConfigError("--port", f"cannot listen on port {port} ({error}); leave it out") from error
