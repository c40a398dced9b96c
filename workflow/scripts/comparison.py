from brdfpipe import store
from brdfpipe.comparison.measured_predicted import compare


def main(input, output, params):
    """The measured BSDF beside the predicted one, and the inputs that would make them agree."""
    names = {"sheet": "predicted", "coated": "predicted"}
    inputs = {names.get(name, name): store.open_dataset(path) for name, path in input.items()}
    store.save_dataset(
        compare(**inputs, **params["spec"]),
        output["comparison"],
        stage="comparison",
        material=params["material"],
        inputs=inputs,
        parameters=params["spec"],
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
