from brdfpipe import store
from brdfpipe.bsdf.slab.builder import build
from brdfpipe.optics import interior


def main(input, output, params):
    """The BSDF of a clear body that facets and roughness spectra of both faces, index and internal transmittance predict."""
    spec = params["spec"]
    inputs = {name: store.open_dataset(path, name.removeprefix("back_")) for name, path in input.items()}
    with_own_back = "back_facets" in inputs
    bsdf = build(
        inputs["facets"],
        inputs["back_facets"] if with_own_back else inputs["facets"],
        front_psd=inputs.get("psd"),
        back_psd=inputs.get("back_psd" if with_own_back else "psd"),
        index=inputs["index"],
        internal_transmittance=interior.spectral(inputs["interior"]),
        **spec,
    )
    store.save_dataset(
        bsdf, output["sheet"], stage="sheet", material=params["material"], inputs=inputs, parameters=spec
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
