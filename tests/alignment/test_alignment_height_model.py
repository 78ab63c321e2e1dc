"""Heights laid onto a model of the ground, or kept as SLAM has them."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from flexmap_tasks.alignment.pose_graph import pose_graph, pose_graph_warp
from flexmap_tasks.config import AlignmentParams, HeightModelInput, HeightModelParams, PoseGraphParams
from flexmap_tasks.errors import CoverageError, InputError
from flexmap_tasks.ingest.height_model import ingest_height_model
from flexmap_tasks.model.height_model import HeightModel
from flexmap_tasks.model.pose_graph import PoseGraph
from flexmap_tasks.model.source import Source
from tests.climbs import Up, climbed, ground_m
from tests.drives import HERE, Driven, driven, rmse

UP = Up(tilt_rad=(0.01, 0.02))
BODY_UP_M = 1.7


@pytest.fixture(scope="module")
def drive() -> Driven:
    """Without any altitude; the SLAM body is `BODY_UP_M` over the ground."""
    one = climbed(driven(2500, 2), UP, 2)
    xyz = one.gnss.xyz_m.copy()
    xyz[:, 2] = np.nan
    return one._replace(gnss=dataclasses.replace(one.gnss, xyz_m=xyz))


def model_of(drive: Driven, step_m: float = 1.0) -> HeightModel:
    """The true ground, to the centimetre of a scan, in UTM."""
    low, high = drive.xyz[:, :2].min(axis=0) - 60, drive.xyz[:, :2].max(axis=0) + 60
    x, y = np.arange(low[0], high[0], step_m), np.arange(high[1], low[1], -step_m)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    height = ground_m(places, UP, 2) + np.random.default_rng(0).normal(size=len(places)) * 0.03
    first = np.array([x[0] + HERE.origin_easting_m, y[0] + HERE.origin_northing_m])
    return HeightModel(height, len(x), *first.tolist(), step_m, -step_m, HERE.epsg, "DHHN2016")


def laid(drive: Driven, model: HeightModel) -> PoseGraph:
    params = PoseGraphParams(height="model", body_up_m=BODY_UP_M)
    return pose_graph(drive.slam, drive.gnss, HERE, None, None, params, model)


def off_m(drive: Driven, graph: PoseGraph) -> np.ndarray:
    return np.asarray(graph.nodes.xyz_m[:, 2] - BODY_UP_M - drive.xyz[graph.nodes.row, 2])


def test_drive_lies_on_the_ground(drive: Driven) -> None:
    graph = laid(drive, model_of(drive))
    assert rmse(off_m(drive, graph)) < 0.05
    assert graph.figures.height == "model, vertical datum DHHN2016"
    assert graph.figures.height_share > 0.99


def test_a_bridge_and_a_hole_are_passed_on_slam_alone(drive: Driven) -> None:
    """The ground lies 7 m under a bridge of 60 m; over 150 m the model knows nothing; below a wood it is scattered."""
    model = model_of(drive)
    height = model.height_m.copy()
    rows = np.arange(len(height))
    x = model.first_x + rows % model.columns - HERE.origin_easting_m
    y = model.first_y - rows // model.columns - HERE.origin_northing_m
    for start, stop, change in ((600.0, 660.0, -7.0), (1200.0, 1350.0, np.nan)):
        way = drive.xyz[(drive.along > start) & (drive.along < stop), :2]
        low, high = way.min(axis=0) - 3, way.max(axis=0) + 3
        height[(x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])] += change
    graph = laid(drive, dataclasses.replace(model, height_m=height))
    assert rmse(off_m(drive, graph)) < 0.10
    assert np.abs(off_m(drive, graph)).max() < 0.5
    assert 0.8 < graph.figures.height_share < 0.98


def test_keep_leaves_heights_alone(drive: Driven) -> None:
    whole = climbed(driven(2500, 2), UP, 2)
    graph = pose_graph(whole.slam, whole.gnss, HERE, None, None, PoseGraphParams(height="keep"))
    assert np.array_equal(graph.nodes.xyz_m[:, 2], graph.nodes.source_xyz_m[:, 2])
    assert np.isnan(graph.nodes.sigma_m[:, 2]).all()
    assert graph.figures.height == "SLAM"
    warp = pose_graph_warp(graph, PoseGraphParams(height="keep"))
    xyz = drive.slam.xyz_m + np.array([3.0, 4.0, 5.0])
    assert np.array_equal(warp.apply(xyz)[:, 2], xyz[:, 2])


def test_a_model_of_elsewhere_is_refused(drive: Driven) -> None:
    far = dataclasses.replace(model_of(drive), first_x=900_000.0)
    with pytest.raises(CoverageError, match="no place of the drive"):
        laid(drive, far)


def lines(path: Path, drive: Driven, model: HeightModel) -> Source:
    rows = np.arange(len(model.height_m))
    x, y = model.first_x + 5 * (rows % model.columns), model.first_y - 5 * (rows // model.columns)
    np.savetxt(path, np.column_stack([x, y, model.height_m]), fmt="%.3f")
    return Source("ground.xyz", path)


def test_reading_cuts_the_model_to_the_drive(drive: Driven, tmp_path: Path) -> None:
    model = model_of(drive, 5.0)
    source = lines(tmp_path / "a", drive, model)
    params = HeightModelParams(epsg=HERE.epsg, vertical_datum="DHHN2016")
    read = ingest_height_model(source, drive.gnss, HERE, params)
    places = drive.xyz[::10, :2]
    assert np.abs(read.at_m(places, HERE) - model.at_m(places, HERE)).max() < 1e-3
    near = dataclasses.replace(drive.gnss, xyz_m=drive.gnss.xyz_m[:5] * [0.0, 0.0, 1.0] - [5e3, 0, 0])
    with pytest.raises(CoverageError, match="the drive lies elsewhere"):
        ingest_height_model(source, near, HERE, params)
    with pytest.raises(InputError, match=r"alignment\.height_model\.epsg"):
        ingest_height_model(source, drive.gnss, HERE, HeightModelParams())
    with pytest.raises(InputError, match="not known"):
        ingest_height_model(source, drive.gnss, HERE, HeightModelParams(epsg=1999))


def test_a_model_is_named_where_it_is_used_and_nowhere_else() -> None:
    ground = HeightModelInput(file=Path("a.tif"))
    with pytest.raises(ValidationError, match="needs height_model"):
        AlignmentParams(pose_graph=PoseGraphParams(height="model"))
    with pytest.raises(ValidationError, match="only"):
        AlignmentParams(height_model=ground)
    assert AlignmentParams(height_model=ground, pose_graph=PoseGraphParams(height="model"))
