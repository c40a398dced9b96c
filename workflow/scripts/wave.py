from brdfpipe import store
from brdfpipe.bsdf.wave.builder import build


def main(input, output, params):
    """The BSDF that roughness spectrum, facets, index and spectrum predict by wave optics, joined with that of facets."""
    kinds, spec = {"predicted": "bsdf"}, params["spec"]
    inputs = {name: store.open_dataset(path, kinds.get(name, name)) for name, path in input.items()}
    choices = {"optics": spec["optics"], "form": spec["halo"], "diffuse": spec["diffuse"]}
    store.save_dataset(
        build(**inputs, **choices),
        output["wave"],
        stage="wave",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
