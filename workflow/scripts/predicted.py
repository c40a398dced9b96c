from brdfpipe import store
from brdfpipe.bsdf import lambert_gauss
from brdfpipe.bsdf.microfacet import phase_variance
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet
from brdfpipe.bsdf.slab.builder import build as build_slab
from brdfpipe.optics import interior


def main(input, output, params):
    """The BSDF that facets, index and spectrum predict; of a clear body, with both its faces; of a colour alone, a Lambertian one."""
    spec = params["spec"]
    inputs = {name: store.open_dataset(path, name.removeprefix("back_")) for name, path in input.items()}
    if "interior" in inputs:
        faces = inputs["facets"], inputs.get("back_facets", inputs["facets"])
        passed = interior.spectral(inputs["interior"])
        bsdf = build_slab(*faces, index=inputs["index"], internal_transmittance=passed, **spec)
    elif "facets" in inputs:
        psd = inputs.pop("psd", None)
        bsdf = build_microfacet(**inputs, **spec)
        bsdf = bsdf if psd is None else phase_variance.with_warning(bsdf, psd)
    else:
        bsdf = lambert_gauss.lambertian(inputs["spectrum"])
    store.save_dataset(
        bsdf, output["predicted"], stage="predicted", material=params["material"], inputs=inputs, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
