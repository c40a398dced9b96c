from brdfpipe import store
from brdfpipe.bsdf.predictions import best_prediction

NOT_STATED = "uncertainty_not_stated"
UNCERTAIN = {
    "predicted": "uncertainty",
    "wave": "uncertainty",
    "sheet": "sheet_uncertainty",
    "coated": "coated_uncertainty",
    "flake": "flake_uncertainty",
}
"""The stage with the changes of the BSDF of each route."""


def main(input, output, params):
    """The BSDF of the best route of the material: measured, else of a file, else of flakes, else predicted."""
    spec = params["spec"]
    kinds = {name: "uncertainty" if name.endswith("uncertainty") else "bsdf" for name, _ in input.items()}
    inputs = {name: store.open_dataset(path, kinds[name]) for name, path in input.items()}
    source = spec["route"]
    if source == "predicted":
        source = best_prediction(inputs)
    bsdf = inputs[source].assign_attrs(route=spec["route"])
    if (changes := inputs.get(UNCERTAIN.get(source, ""))) is not None:
        # The changes of variables stand beside these.
        bsdf = bsdf.merge(changes, combine_attrs="override")
        bsdf.attrs |= {NOT_STATED: changes.attrs[NOT_STATED]}
    store.save_dataset(bsdf, output["bsdf"], stage="bsdf", material=params["material"], inputs=inputs, parameters=spec)


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
