"""Figures of the pages, as inline SVG: charts of each dataset, and the axes, curves and rasters that they are drawn with."""
