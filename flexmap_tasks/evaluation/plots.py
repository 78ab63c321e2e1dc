"""The plots of an evaluation as SVG: the same figures give the same bytes."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from flexmap_tasks.evaluation.calibration import BINS, Reliability
from flexmap_tasks.model.arrays import Bools, Floats

BLUE, ORANGE, GREY = "#1f5fa8", "#d9701a", "#9aa0a6"
STYLE: dict[Any, Any] = {
    "svg.hashsalt": "flexmap", "svg.fonttype": "none", "font.size": 10.0, "axes.spines.top": False,
    "axes.spines.right": False, "axes.grid": True, "grid.color": "#e3e5e8", "axes.axisbelow": True,
}  # fmt: skip
MAX_DOTS = 20_000
"""More dots than this only make a map slow to open."""


def error_along_route(along_m: Floats, planar_m: Floats, up_m: Floats, outage: Bools) -> bytes:
    """Error of the trajectory over the distance driven, stretches without GNSS shaded."""
    with mpl.rc_context(STYLE):
        figure, (axes,) = _figure(9.0, 3.4)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], outage, [False]]).astype(np.int8)))
        for k, (first, last) in enumerate(edges.reshape(-1, 2).tolist()):
            label = "no GNSS" if k == 0 else None
            axes.axvspan(along_m[first], along_m[last - 1], color=GREY, alpha=0.35, lw=0, label=label)
        level = np.abs(up_m - np.median(up_m)) if len(up_m) else up_m
        axes.plot(along_m, level, color=ORANGE, lw=1.0, label="height, less its median")
        axes.plot(along_m, planar_m, color=BLUE, lw=1.4, label="in the plane")
        axes.set(xlabel="distance driven (m)", ylabel="error (m)", title="Trajectory against the truth")
        axes.set_ylim(bottom=0.0)
        axes.legend(frameon=False, ncols=3)
        return _svg(figure)


def error_map(xy_m: Floats, error_m: Floats) -> bytes:
    """Every node of the map, coloured by its error in the plane."""
    with mpl.rc_context(STYLE):
        figure, (axes,) = _figure(7.0, 6.0)
        step = max(1, -(-len(xy_m) // MAX_DOTS))
        order = np.argsort(error_m, kind="stable")[::step]
        top = max(float(np.percentile(error_m, 99)), 1e-3) if len(error_m) else 1.0
        dots = axes.scatter(*xy_m[order].T, c=error_m[order], s=5, cmap="viridis", vmin=0, vmax=top, lw=0)
        figure.colorbar(dots, ax=axes, label="error in the plane (m)", extend="max")
        axes.set(xlabel="east (m)", ylabel="north (m)", title="Map against the truth", aspect="equal")
        return _svg(figure)


def reliability_diagram(found: Reliability) -> bytes:
    """How often matches of a confidence are right; on the diagonal they are honest."""
    with mpl.rc_context(STYLE):
        figure, (axes, below) = _figure(5.0, 5.6, heights=(3.0, 1.0))
        middles = (np.arange(BINS) + 0.5) / BINS
        axes.plot([0, 1], [0, 1], color=GREY, lw=1.0, label="honest")
        filled = found.metres > 0
        axes.bar(middles[filled], found.accuracy[filled], width=0.09, color=BLUE, alpha=0.3, lw=0)
        axes.plot(
            found.confidence[filled], found.accuracy[filled], "o-", color=BLUE, lw=1.2, label="measured"
        )
        gap = "none" if found.error is None else f"{found.error:.3f}"
        axes.set(xlim=(0, 1), ylim=(0, 1.02), ylabel="share that is right", title=f"Confidence (ECE {gap})")
        axes.legend(frameon=False, loc="upper left")
        below.bar(middles, found.metres, width=0.09, color=GREY)
        below.set(xlim=(0, 1), xlabel="confidence", ylabel="metres")
        return _svg(figure)


def width_change_histogram(change_m: Floats) -> bytes:
    """How much the move changed the widths of lanes."""
    with mpl.rc_context(STYLE):
        figure, (axes,) = _figure(6.0, 3.4)
        top = max(float(change_m.max(initial=0.0)), 0.02)
        axes.hist(change_m, bins=np.linspace(0.0, top, 41), color=BLUE)
        axes.axvline(0.1, color=ORANGE, lw=1.2, label="10 cm")
        axes.set(
            xlabel="change of lane width (m)", ylabel="cross sections", title="Lane widths", yscale="symlog"
        )
        axes.legend(frameon=False)
        return _svg(figure)


def curves(
    panels: Mapping[str, Mapping[str, Sequence[tuple[float, float, float, float]]]], x_label: str
) -> bytes:
    """One panel per title, one curve per name through points of (x, mean, least, greatest)."""
    with mpl.rc_context(STYLE):
        figure, every = _figure(6.5, 3.2 * max(len(panels), 1), (1.0,) * max(len(panels), 1))
        for axes, (title, lines) in zip(every, panels.items(), strict=False):
            for colour, (name, points) in zip((BLUE, ORANGE, GREY), lines.items(), strict=False):
                x, mean, least, most = np.array(points).T
                axes.fill_between(x, least, most, color=colour, alpha=0.2, lw=0)
                axes.plot(x, mean, "o-", color=colour, lw=1.4, ms=4, label=name.replace("_", " "))
            axes.set(xlabel=x_label, ylabel=title)
            axes.legend(frameon=False)
        return _svg(figure)


def _figure(width: float, height: float, heights: tuple[float, ...] = (1.0,)) -> tuple[Figure, list[Any]]:
    figure = Figure(figsize=(width, height), layout="constrained")
    grid = figure.add_gridspec(len(heights), 1, height_ratios=heights)
    return figure, [figure.add_subplot(grid[k, 0]) for k in range(len(heights))]


def _svg(figure: Figure) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    return out.getvalue()
