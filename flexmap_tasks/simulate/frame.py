"""The town's own metres, and where they are on Earth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from flexmap_tasks.geometry.utm import grid_factors, height_factor, to_lonlat, to_utm, utm_epsg
from flexmap_tasks.model.arrays import Floats


@dataclass(frozen=True, slots=True)
class TownFrame:
    """True metres of the town: x grid east, y grid north, z up, all from the place's origin.

    The frame is the transverse Mercator projection of the place's UTM zone, divided by the grid scale at
    the anchor (where the drive starts) and its height. So it has scale 1 on the ground there, and a rigid
    motion plus that one grid scale leads from it to UTM without any rest. The price: away from the anchor
    its metre is not quite a geodetic one, under 4 ppm per kilometre anywhere in a zone, less than any
    survey of a town can see.

    epsg : UTM zone, WGS84; easting_m, northing_m : of the origin; height_m : of z = 0 over the ellipsoid
    scale : grid metres per metre of this frame
    """

    epsg: int
    easting_m: float
    northing_m: float
    height_m: float
    scale: float

    @classmethod
    def at(cls, lat_deg: float, lon_deg: float, height_m: float) -> TownFrame:
        """The frame with its anchor at its origin."""
        epsg = utm_epsg(lon_deg, lat_deg)
        east, north = to_utm(np.array([[lon_deg, lat_deg]]), epsg)[0].tolist()
        return cls(epsg, east, north, height_m, _grid_scale(lon_deg, lat_deg, height_m, epsg))

    def anchored(self, xyz_m: Floats) -> TownFrame:
        """The same frame with its scale taken at xyz_m (3,) of this one."""
        lon, lat, height = self.geodetic(xyz_m[None])[0].tolist()
        return replace(self, scale=_grid_scale(lon, lat, height, self.epsg))

    def utm(self, xyz_m: Floats) -> Floats:
        """(n, 3) easting, northing, ellipsoidal height."""
        return np.column_stack(
            [
                self.easting_m + self.scale * xyz_m[:, 0],
                self.northing_m + self.scale * xyz_m[:, 1],
                self.height_m + xyz_m[:, 2],
            ]
        )

    def geodetic(self, xyz_m: Floats) -> Floats:
        """(n, 3) lon, lat in WGS84 degrees and ellipsoidal height."""
        utm = self.utm(xyz_m)
        return np.column_stack([to_lonlat(utm[:, :2], self.epsg), utm[:, 2]])

    def local(self, lonlat_deg: Floats) -> Floats:
        """(n, 2) metres of this frame of lonlat_deg (n, 2)."""
        return np.asarray((to_utm(lonlat_deg, self.epsg) - [self.easting_m, self.northing_m]) / self.scale)


def _grid_scale(lon_deg: float, lat_deg: float, height_m: float, epsg: int) -> float:
    return grid_factors(lon_deg, lat_deg, epsg)[1] * height_factor(height_m)
