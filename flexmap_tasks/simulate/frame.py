"""The town's own metres, and where they are on Earth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import Transformer

from flexmap_tasks.geometry.utm import grid_scale_factor, scale_and_convergence, utm_epsg
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
        easting, northing = Transformer.from_crs(4326, epsg, always_xy=True).transform(lon_deg, lat_deg)
        point_scale, _ = scale_and_convergence(epsg, lon_deg, lat_deg)
        return cls(epsg, easting, northing, height_m, grid_scale_factor(point_scale, height_m))

    def anchored(self, xyz_m: Floats) -> TownFrame:
        """The same frame with its scale taken at xyz_m (3,) of this one."""
        lon, lat, height = (float(v[0]) for v in self.geodetic(xyz_m[None]).T)
        point_scale, _ = scale_and_convergence(self.epsg, lon, lat)
        scale = grid_scale_factor(point_scale, height)
        return TownFrame(self.epsg, self.easting_m, self.northing_m, self.height_m, scale)

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
        lon, lat = Transformer.from_crs(self.epsg, 4326, always_xy=True).transform(utm[:, 0], utm[:, 1])
        return np.column_stack([lon, lat, utm[:, 2]])

    def local(self, lonlat_deg: Floats) -> Floats:
        """(n, 2) metres of this frame of lonlat_deg (n, 2)."""
        transformer = Transformer.from_crs(4326, self.epsg, always_xy=True)
        east, north = transformer.transform(lonlat_deg[:, 0], lonlat_deg[:, 1])
        return np.column_stack([(east - self.easting_m) / self.scale, (north - self.northing_m) / self.scale])
