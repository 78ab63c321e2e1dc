"""Alignment by pose graph: cost and growth beside evo's alignment, and what it reaches on known and on real drives."""

from __future__ import annotations

import time

import numpy as np
from evo.core.geometry import umeyama_alignment

from flexmap_tasks.alignment.heldout import heldout
from flexmap_tasks.alignment.pose_graph import antenna_track, pose_graph
from flexmap_tasks.alignment.project import project_utm
from flexmap_tasks.config import (
    GnssParams,
    GraphHeldOutParams,
    PoseGraphParams,
    ProjectionParams,
    SlamParams,
)
from flexmap_tasks.evaluation.deviation import deviation
from flexmap_tasks.geometry.rigid import fit_planar_motion
from flexmap_tasks.ingest.gnss import ingest_gnss
from flexmap_tasks.ingest.slam import ingest_slam
from flexmap_tasks.model.pose_graph import PoseGraph
from flexmap_tasks.model.source import Source
from tests.bench.measure import DATA, best_cpu_s, show
from tests.climbs import Up, climbed
from tests.drives import HERE, Bias, Driven, driven, rmse, untimed


def run() -> None:
    """Cost and growth, then accuracy."""
    _growth()
    _simulated()
    _heights()
    _garching()


def _growth() -> None:
    drive = driven(5_000, 1)
    peer = best_cpu_s(lambda: umeyama_alignment(drive.slam.xyz_m.T, drive.xyz.T))
    rigid = best_cpu_s(lambda: fit_planar_motion(drive.slam.xyz_m[:, :2], drive.xyz[:, :2]))
    one = best_cpu_s(lambda: _solved(drive))
    text = best_cpu_s(lambda: _solved(untimed(drive)))
    rows = [
        ("5 km with time", f"{one:.2f} s CPU", "at most 2 s"),
        ("5 km, text files without time", f"{text:.2f} s CPU", "at most 2 s"),
        ("evo's rigid alignment of the same poses, pairs given", f"{1e3 * peer:.2f} ms CPU", ""),
        ("FlexMap's, in the plane", f"{1e3 * rigid:.2f} ms CPU", ""),
    ]
    for length_km in (50, 500):
        long = driven(1e3 * length_km, 1)
        before = time.process_time()
        graph = _solved(long)
        cpu = time.process_time() - before
        goal = f"about {length_km // 5} times"
        rows.append((f"{length_km} km with time", f"{cpu:.1f} s CPU = {cpu / one:.0f} times 5 km", goal))
        rows.append(
            ("  its distance from the truth, RMSE in the plane", f"{rmse(_error(long, graph)):.3f} m", "")
        )
    show("Alignment by pose graph", rows)


def _simulated() -> None:
    rows = []
    for name, goal, gaps, biases in (
        ("observed", 0.06, (), ()),
        ("100 m gap", 0.10, ((700.0, 800.0),), ()),
        ("280 m outage", 0.40, ((900.0, 1180.0),), ()),
        ("100 m of 1.2 m multipath", 0.20, (), (Bias(1000.0, 1100.0, 0.85, 0.85),)),
    ):
        errors = []
        for seed in range(4):
            drive = driven(2500, seed, gaps=gaps, biases=biases)
            graph = _solved(drive)
            at, inside = drive.along[graph.nodes.row], np.zeros(len(graph.nodes), bool)
            for start, stop in [*gaps, *((b.start_m, b.stop_m) for b in biases)]:
                inside |= (at > start) & (at < stop)
            errors.append(rmse(_error(drive, graph)[inside if inside.any() else ~inside]))
        rows.append(
            (
                name,
                f"{np.mean(errors):.3f} m, the worst of {len(errors)} drives {max(errors):.3f} m",
                f"at most {goal} m",
            )
        )
    show("Simulated drives of 2.5 km: distance from the truth, RMSE in the plane where the name says", rows)


def _heights() -> None:
    rows = []
    for name, up in (
        ("altitudes of 3 cm, SLAM tilted by a degree", Up(tilt_rad=(0.02, -0.015))),
        ("slow errors of 5 cm", Up(slow_m=0.05)),
        ("half a metre of scatter", Up(white_m=0.5)),
        ("every fifth anywhere", Up(outliers=0.2)),
        ("30 m off over 40 % of the way", Up(steps=((900.0, 2100.0, 30.0),))),
        ("8 m off between two gaps of 200 m", Up(steps=((800, 1200, 8.0),), gaps=((700, 900), (1100, 1300)))),
        ("300 m without", Up(gaps=((1000.0, 1300.0),))),
        ("whole metres", Up(resolution_m=1.0)),
    ):
        errors = []
        for seed in range(3):
            drive = climbed(driven(3000, seed), up, seed)
            params = PoseGraphParams(antenna_up_m=up.lever_up_m)
            nodes = pose_graph(drive.slam, drive.gnss, HERE, None, None, params).nodes
            errors.append(rmse(nodes.xyz_m[:, 2] - drive.xyz[nodes.row, 2]))
        rows.append(
            (name, f"{np.mean(errors):.3f} m, worst of {len(errors)} {max(errors):.3f}", "at most 0.10")
        )
    show("Simulated drives over hills, height RMSE", rows)


def _garching() -> None:
    folder = DATA / "garching"
    slam = ingest_slam(Source("slam", folder / "route1_pose_kitti.txt"), SlamParams())
    fixes = ingest_gnss(Source("gnss", folder / "route_1_GPS.txt"), GnssParams())
    projected = project_utm(fixes, ProjectionParams())
    gnss, projection = projected.gnss_track, projected.projection
    graph = pose_graph(slam, gnss, projection, None, None, PoseGraphParams())
    off = deviation(antenna_track(graph).xyz_m, gnss)
    rigid = deviation(graph.motion.apply_xy(slam.xyz_m[:, :2]), gnss)
    rows = [
        ("valid poses, RMSE", f"{rmse(off.distance_m[off.valid]):.3f} m", "at most 0.06 m"),
        ("all poses, mean", f"{off.distance_m.mean():.3f} m", "at most 0.40 m"),
        ("robust rigid alone, all poses, RMSE", f"{rmse(rigid.distance_m):.2f} m", "at most 2.4 m"),
        ("same road passed twice, p90", f"{graph.figures.revisit_disagreement_m:.3f} m", "at most 0.08 m"),
        ("lever arm forward", f"{graph.figures.lever_forward_m:.2f} m", "2.06 +- 0.15 m"),
        ("lever arm left", f"{graph.figures.lever_left_m:.2f} m", "0.49 +- 0.05 m"),
    ]
    for block_m, goal in ((50.0, 0.10), (100.0, 0.15), (250.0, 0.25)):
        judged = heldout(slam, gnss, projection, GraphHeldOutParams(block_m=block_m))
        rows.append(
            (
                f"held-out blocks of {block_m:.0f} m, RMSE",
                f"{rmse(judged.distance_m):.3f} m",
                f"at most {goal} m",
            )
        )
    show("Garching, no hand input", rows)


def _solved(drive: Driven) -> PoseGraph:
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, PoseGraphParams())


def _error(drive: Driven, graph: PoseGraph) -> np.ndarray:
    return np.hypot(*(graph.nodes.xyz_m - drive.xyz[graph.nodes.row])[:, :2].T)
