"""The rendered picture of the material."""

from __future__ import annotations

import xarray as xr
from markupsafe import Markup

from brdfpipe.report.plots.svg import Figure, png

_LIGHTS = {
    "studio": "three soft boxes and a dim sky",
    "sun": "a small sun and a clear sky",
    "overcast": "an overcast sky",
}


def picture(preview: xr.Dataset | None) -> Figure | None:
    """The preview as a figure; None without one."""
    if preview is None:
        return None
    pixels = preview["picture"].values
    subject = f"Sphere and flat panel under {_LIGHTS.get(str(preview.attrs['light']), 'lights')}"
    markup = Markup('<img class="look" src="{}" width="{}" height="{}" alt="{}">')
    note = (
        f"{subject}, spectrum of {preview.attrs['illuminant']}. Rendered from the BRDF. The exposure is the same for every material: "
        f"a perfect white diffuser reaches {100 * float(preview.attrs['white_level']):.0f} % of the screen's white. Brighter light is "
        "compressed."
    )
    return Figure("Preview", markup.format(png(pixels), pixels.shape[1], pixels.shape[0], subject), note=note)
