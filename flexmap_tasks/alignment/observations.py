"""Everything the pose graph knows, as groups of observations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from flexmap_tasks.alignment.correspondence import Correspondence
from flexmap_tasks.alignment.drive import PART_M
from flexmap_tasks.geometry.adjustment import Group
from flexmap_tasks.geometry.graph2d import GLOBALS, Fix, Relative, State, fix_rows, relative_rows
from flexmap_tasks.model.arrays import Floats

ALONG, YAW, GNSS, ACROSS, REVISIT, REVISIT_YAW, SCALE_DRIFT, YAW_DRIFT = range(8)
"""Places of the groups whose noise is estimated."""

START = np.array([0.01, 0.001, 1.0, 0.01, 1.0, 0.02, 0.005, 1e-4])
"""Where the estimates begin: metres and radians per 3 m of SLAM, a factor on the stated sigmas of GNSS, and metres
and radians by which SLAM disagrees with itself where it passes twice."""

BEGIN = START * [10.0, 1.0, 1.0, 10.0, 1.0, 1.0, 4.0, 1.0]
"""Noise that SLAM is given while a start without time is metres off: corners that do not fit yet would else be taken
for outliers."""

EXPECTED = np.array([0.01, 0.001, 1.0, 0.01, 0.05, 0.005, 5e-4, 2e-5])
"""What is expected of each where a drive says little of it."""

FLOOR = np.array([5e-3, 2e-5, 0.2, 5e-3, 0.05, 3e-3, 1e-5, 1e-7])
"""Noise below this is not believed of any sensor."""

STEP_M = 3.0
"""SLAM noise is stated over this way and grows with its root."""

UNTIMED_ALONG_M = 100.0
"""Without time fixes say nothing along the track: all of them together as much as one of this deviation, which only
keeps the equations regular."""

ALIKE_M = 200.0
"""SLAM's scale and yaw rate err alike over about this way."""

LEVER_M, SCALE = 3.0, 0.01
"""What is known beforehand of lever arm (a car's size) and SLAM scale, one standard deviation."""


class Known(NamedTuple):
    """What stays the same from step to step.

    odometry, revisit : what SLAM says of neighbours, and of passes of one place
    control, control_sigma_m : the user's places
    timed : fixes are tied by time; log_scale : logarithm of the scale known beforehand
    clock_sigma_s : what is known of the clock offset
    """

    odometry: Relative
    revisit: Relative
    control: Fix
    control_sigma_m: Floats
    timed: bool
    log_scale: float
    clock_sigma_s: float


def groups_of(known: Known, found: Correspondence, state: State) -> list[Group]:
    """All observations, linearised at a state."""
    odometry = relative_rows(state, known.odometry)
    unit = np.sqrt(np.maximum(np.hypot(*known.odometry.motion[:, :2].T), 0.1) / STEP_M)
    along, across, yaw = (
        Group(odometry.residual[k::3], odometry.jacobian[k::3], unit, None, 0) for k in range(3)
    )
    fixes = fix_rows(state, found.fix)
    count = len(found.sigma_m)
    if known.timed:
        each = np.repeat(np.arange(count), 2)
        gnss = Group(fixes.residual, fixes.jacobian, np.repeat(found.sigma_m, 2), each, GNSS)
    else:
        gnss = Group(fixes.residual[0::2], fixes.jacobian[0::2], found.sigma_m, np.arange(count), GNSS)
    out = [
        along._replace(scale_of=ALONG if known.timed else ACROSS),
        yaw._replace(scale_of=YAW),
        gnss,
        across._replace(scale_of=ACROSS),
        *_revisits(known, state),
        *_drifts(state),
        _shared(known, state),
    ]
    if not known.timed:
        far = np.full(count, UNTIMED_ALONG_M * np.sqrt(count))
        out.append(Group(fixes.residual[1::2], fixes.jacobian[1::2], far, None, -1))
    if len(known.control.node):
        control = fix_rows(state, known.control, antenna=False)
        out.append(Group(control.residual, control.jacobian, np.repeat(known.control_sigma_m, 2), None, -1))
    return out


def _shared(known: Known, state: State) -> Group:
    columns = state.unknowns - GLOBALS + np.arange(GLOBALS)
    jacobian = sparse.csr_matrix(
        (np.ones(GLOBALS), (np.arange(GLOBALS), columns)), shape=(GLOBALS, state.unknowns)
    )
    expected = np.array([0.0, 0.0, known.log_scale, 0.0])
    sigma = np.array([LEVER_M, LEVER_M, SCALE, max(known.clock_sigma_s, 1e-9)])
    return Group(state.shared - expected, jacobian, sigma, None, -1)


def _drifts(state: State) -> list[Group]:
    """A Gauss-Markov process of first order, stationary: drift is alike over `ALIKE_M`, its deviation estimated."""
    parts = len(state.drift)
    keep = np.exp(-PART_M / ALIKE_M)
    walk = (sparse.eye(parts) - keep * sparse.eye(parts, k=-1)).tocoo()
    unit = np.full(parts, np.sqrt(1.0 - keep**2))
    unit[0] = 1.0
    out = []
    for which, group in ((0, SCALE_DRIFT), (1, YAW_DRIFT)):
        columns = state.pose.size + 2 * walk.col + which
        jacobian = sparse.csr_matrix((walk.data, (walk.row, columns)), shape=(parts, state.unknowns))
        out.append(Group(walk @ state.drift[:, which], jacobian, unit, np.arange(parts), group))
    return out


def _revisits(known: Known, state: State) -> list[Group]:
    """How well SLAM agrees with itself is estimated: loops closed or not, both are common."""
    rows = relative_rows(state, known.revisit)
    pair = np.arange(len(known.revisit.first))
    place = np.sort(np.concatenate([3 * pair, 3 * pair + 1]))
    return [
        Group(rows.residual[place], rows.jacobian[place], np.ones(len(place)), np.repeat(pair, 2), REVISIT),
        Group(rows.residual[2::3], rows.jacobian[2::3], np.ones(len(pair)), pair, REVISIT_YAW),
    ]
