"""Maps and tracks from files, through the libraries that read them well.

netCDF by xarray; GeoTIFF, Surfer and ERMapper grids by rasterio (GDAL); Oasis montaj grids by harmonica; Parquet by
pandas; text of every kind by one reader here. `pip install 'geomag-nav[io]'` brings them.
"""

from geomag.io._grids import open_grid, read_grid, save_grid
from geomag.io._make import close_seam
from geomag.io._netcdf import grid_from_xarray, grid_to_xarray
from geomag.io._tables import floats, read_table
from geomag.io._tracks import line_points, read_track, track_from_pandas, track_to_pandas

__all__ = ["close_seam", "floats", "grid_from_xarray", "grid_to_xarray", "line_points", "open_grid", "read_grid", "read_table", "read_track", "save_grid",
           "track_from_pandas", "track_to_pandas"]  # fmt: skip
