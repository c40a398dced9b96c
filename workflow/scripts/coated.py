from brdfpipe import store
from brdfpipe.bsdf.slab.coated import build
from brdfpipe.optics import interior


def main(input, output, params):
    """The BSDF that both faces, both indices, the coat and the spectrum predict of a coated body."""
    spec = dict(params["spec"])
    inputs = {name: store.open_dataset(path, name.removeprefix("base_")) for name, path in input.items()}
    # A face of the body that has no dataset is smooth, or has the slopes of the coat.
    below = inputs["facets"] if spec.pop("base", None) == "same" else inputs.get("base_facets")
    indices = {"coat_index": inputs["index"], "index": inputs["base_index"]}
    coat = {
        "internal_transmittance": interior.spectral(inputs["interior"]),
        "thickness": float(inputs["interior"]["thickness"]),
    }
    bsdf = build(inputs["facets"], below, **indices, **coat, spectrum=inputs.get("spectrum"), **spec)
    store.save_dataset(
        bsdf, output["coated"], stage="coated", material=params["material"], inputs=inputs, parameters=params["spec"]
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
