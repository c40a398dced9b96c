from brdfpipe import store
from brdfpipe.bsdf.slab.coated_uncertainty import uncertainty


def main(input, output, params):
    """The changes of the BSDF of a coated body by the uncertainties of its inputs."""
    spec = params["spec"]
    kinds = {name: "bsdf" if name == "coated" else name.removeprefix("base_") for name, _ in input.items()}
    inputs = {name: store.open_dataset(path, kinds[name]) for name, path in input.items()}
    given = {name: dataset for name, dataset in inputs.items() if name != "coated"}
    if spec.get("base") == "same":
        given["base_facets"] = inputs["facets"]
    store.save_dataset(
        uncertainty(inputs["coated"], **given),
        output["coated_uncertainty"],
        stage="coated_uncertainty",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
