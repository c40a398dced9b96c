from brdfpipe import store
from brdfpipe.bsdf.slab.coated import build
from brdfpipe.optics import interior


def main(input, output, params):
    """The BSDF that both faces, both indices, the coat and the spectrum predict of a coated body."""
    spec = dict(params["spec"])
    inputs = {name: store.open_dataset(path, name.removeprefix("base_")) for name, path in input.items()}
    # A face of the body that has no dataset is smooth, or has the slopes of the coat.
    below = inputs["facets"] if spec.pop("base", None) == "same" else inputs.get("base_facets")
    bsdf = build(
        inputs["facets"],
        below,
        coat_index=inputs["index"],
        index=inputs["base_index"],
        spectrum=inputs.get("spectrum"),
        internal_transmittance=interior.spectral(inputs["interior"]),
        thickness=float(inputs["interior"]["thickness"]),
        **spec,
    )
    store.save_dataset(
        bsdf, output["coated"], stage="coated", material=params["material"], inputs=inputs, parameters=params["spec"]
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
