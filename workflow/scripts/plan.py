from pathlib import Path

from brdfpipe import store
from brdfpipe.scenes import experience
from brdfpipe.scenes.model_inputs import ModelInputs
from brdfpipe.scenes.planning import plan


def main(input, output, params):
    """The cheapest model whose error a scene accepts, by what was measured on other materials."""
    paths = dict(input.items())
    known = experience.read(Path(paths.pop("experience"))) if "experience" in paths else experience.NONE
    inputs = {name: store.open_dataset(path, name) for name, path in paths.items()}
    spec = params["spec"]
    store.save_dataset(
        plan(ModelInputs(**inputs), known, **spec),
        output["plan"],
        stage="plan",
        material=params["material"],
        inputs=inputs,
        parameters=spec,
    )


if __name__ == "__main__":
    from brdfpipe.jobs.stage import run_as_script

    run_as_script(main)
