from brdfpipe import store
from brdfpipe.bsdf import lambert_gauss
from brdfpipe.bsdf.microfacet import phase_variance
from brdfpipe.bsdf.microfacet.builder import build as build_microfacet


def main(input, output, params):
    """The BSDF that facets, index and spectrum predict; of a colour alone, a Lambertian one."""
    alone = params["spec"].get("optics") == "facets"
    inputs = {name: store.open_dataset(path, name) for name, path in input.items()}
    if "facets" in inputs:
        psd = inputs.pop("psd", None)
        bsdf = build_microfacet(**inputs, **{key: mode for key, mode in params["spec"].items() if key != "optics"})
        bsdf = phase_variance.with_warning(bsdf, psd) if psd is not None and alone else bsdf
    else:
        bsdf = lambert_gauss.lambertian(inputs["spectrum"])
    store.save_dataset(
        bsdf,
        output["predicted"],
        stage="predicted",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
