from brdfpipe import store
from brdfpipe.comparison.model_error import model_error


def main(input, output, params):
    """The predicted BSDF beside rays and diffraction on its own scans."""
    paths = [input["surface"], *input.get("scan", [])]
    scans = {f"surface-{k}": store.open_dataset(path, "surface") for k, path in enumerate(paths, start=1)}
    facets = store.open_dataset(input["facets"], "facets")
    name = "wave" if "wave" in input else "predicted"
    predicted = store.open_dataset(input[name], "bsdf")
    store.save_dataset(
        model_error(list(scans.values()), predicted, facets),
        output["model_error"],
        stage="model_error",
        material=params["material"],
        inputs=scans | {"facets": facets, name: predicted},
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
