from brdfpipe import store
from brdfpipe.comparison.model_error import model_error


def main(input, output, params):
    """The predicted BSDF beside rays and diffraction on its own height map."""
    surface = store.open_dataset(input["surface"], "surface")
    predictions = {name: store.open_dataset(path, "bsdf") for name, path in input.items() if name != "surface"}
    predicted = predictions.get("wave", predictions.get("predicted"))
    store.save_dataset(
        model_error(surface, predicted),
        output["model_error"],
        stage="model_error",
        material=params["material"],
        inputs={"surface": surface, **predictions},
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
