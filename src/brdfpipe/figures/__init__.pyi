from .bsdf_plots import BSDFPlots as BSDFPlots
